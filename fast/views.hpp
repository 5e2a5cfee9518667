// Arrays of numpy as the kernels see them: own axes with strides, and lanes, however they lie.
#pragma once

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#include <cstring>
#include <vector>

// Lanes that are computed at once: one AVX-512 register, two of AVX2.
constexpr Py_ssize_t WIDTH = 8;
typedef double Vector __attribute__((vector_size(WIDTH * sizeof(double))));
typedef long long Bits __attribute__((vector_size(WIDTH * sizeof(double))));

// A float64 array whose axes are lanes, but for `own` of them; released with the object.
class View {
  public:
    View() { buffer_.obj = nullptr; }
    View(const View &) = delete;
    View &operator=(const View &) = delete;
    ~View() {
        if (buffer_.obj) PyBuffer_Release(&buffer_);
    }

    // Lanes lie between `before` own axes and the rest; false with an exception set if not float64.
    bool open(PyObject *array, int before, int after, bool writable) {
        int flags = PyBUF_STRIDES | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0);
        if (PyObject_GetBuffer(array, &buffer_, flags)) return false;
        if (std::strcmp(buffer_.format, "d") || buffer_.ndim < before + after) {
            PyErr_SetString(PyExc_TypeError, "the kernels take float64 arrays with all their axes");
            return false;
        }
        int lane_axes = buffer_.ndim - before - after;
        for (int axis = 0; axis < before; ++axis) own_[axis] = buffer_.strides[axis];
        for (int axis = 0; axis < after; ++axis)
            own_[before + axis] = buffer_.strides[before + lane_axes + axis];
        spread_lanes(buffer_.shape + before, buffer_.strides + before, lane_axes);
        return true;
    }

    Py_ssize_t lanes() const { return lanes_; }
    int axes() const { return buffer_.ndim; }
    Py_ssize_t length(int axis) const { return buffer_.shape[axis]; }

    // Lanes `first` and following at one place of the own axes; past the end the last is repeated.
    Vector load(Py_ssize_t first, Py_ssize_t i = 0, Py_ssize_t j = 0) const {
        const char *place = at(i, j);
        Vector values;
        if (stride_ == sizeof(double) && first + WIDTH <= lanes_) {
            std::memcpy(&values, place + first * stride_, sizeof values);
        } else if (stride_ == 0) {
            values = *reinterpret_cast<const double *>(place) - Vector{};
        } else {
            for (Py_ssize_t k = 0; k < WIDTH; ++k) {
                Py_ssize_t lane = first + k < lanes_ ? first + k : lanes_ - 1;
                values[k] = *reinterpret_cast<const double *>(place + offset(lane));
            }
        }
        return values;
    }

    void store(Vector values, Py_ssize_t first, Py_ssize_t i = 0, Py_ssize_t j = 0) const {
        char *place = at(i, j);
        if (stride_ == sizeof(double) && first + WIDTH <= lanes_) {
            std::memcpy(place + first * stride_, &values, sizeof values);
        } else {
            for (Py_ssize_t k = 0; k < WIDTH && first + k < lanes_; ++k)
                *reinterpret_cast<double *>(place + offset(first + k)) = values[k];
        }
    }

  private:
    char *at(Py_ssize_t i, Py_ssize_t j) const {
        return static_cast<char *>(buffer_.buf) + i * own_[0] + j * own_[1];
    }

    Py_ssize_t offset(Py_ssize_t lane) const {
        return table_.empty() ? lane * stride_ : table_[lane];
    }

    // One stride for all lanes where their axes fold into one, else a table of offsets.
    void spread_lanes(const Py_ssize_t *shape, const Py_ssize_t *strides, int axes) {
        stride_ = 0;
        bool folds = true, seen = false;
        Py_ssize_t span = 0;
        for (int axis = axes - 1; axis >= 0; --axis) {
            lanes_ *= shape[axis];
            if (shape[axis] == 1) continue;
            if (!seen) stride_ = strides[axis];
            else folds = folds && strides[axis] == span;
            span = strides[axis] * shape[axis];
            seen = true;
        }
        if (folds) return;
        stride_ = -1;
        table_.resize(lanes_);
        std::vector<Py_ssize_t> index(axes, 0);
        Py_ssize_t place = 0;
        for (Py_ssize_t lane = 0; lane < lanes_; ++lane) {
            table_[lane] = place;
            for (int axis = axes - 1; axis >= 0; --axis) {
                place += strides[axis];
                if (++index[axis] < shape[axis]) break;
                place -= strides[axis] * shape[axis];
                index[axis] = 0;
            }
        }
    }

    Py_buffer buffer_;
    Py_ssize_t own_[4] = {0, 0, 0, 0};
    Py_ssize_t lanes_ = 1, stride_ = 0;
    std::vector<Py_ssize_t> table_;
};
