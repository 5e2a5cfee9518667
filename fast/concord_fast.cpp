// Compiled kernels for concord: the parts of a UKF step and of a fusion that are not the user's
// models. Sizes are compile-time constants, up to 8 states and 8 readings.
// The only callers are filters/compiled.py and filters/ukf_compiled.py: shapes are checked there.
#include "fused.hpp"

namespace {

constexpr Py_ssize_t STATES = 8, READINGS = 8;
// Grows with every change of what filters/compiled.py and filters/ukf_compiled.py call.
constexpr long INTERFACE = 4;

PyObject *too_large(Py_ssize_t n, Py_ssize_t m) {
    return PyErr_Format(PyExc_ValueError,
                        "no kernel for %zd states and %zd readings: there are up to %zd and %zd", n,
                        m, STATES, READINGS);
}

// Run<N>::run(arguments...) for the N that equals n.
template <template <int> class Run, int N = STATES, class... Arguments>
bool of_size(Py_ssize_t n, const Arguments &...arguments) {
    if constexpr (N == 0) {
        return false;
    } else {
        if (n != N) return of_size<Run, N - 1>(n, arguments...);
        Run<N>::run(arguments...);
        return true;
    }
}

template <template <int, int> class Run, int N, int M = READINGS, class... Arguments>
bool of_readings(Py_ssize_t m, const Arguments &...arguments) {
    if constexpr (M == 0) {
        return false;
    } else {
        if (m != M) return of_readings<Run, N, M - 1>(m, arguments...);
        Run<N, M>::run(arguments...);
        return true;
    }
}

template <template <int, int> class Run, int N = STATES, class... Arguments>
bool of_sizes(Py_ssize_t n, Py_ssize_t m, const Arguments &...arguments) {
    if constexpr (N == 0) {
        return false;
    } else {
        if (n != N) return of_sizes<Run, N - 1>(n, m, arguments...);
        return of_readings<Run, N>(m, arguments...);
    }
}

PyObject *spread(PyObject *, PyObject *const *given, Py_ssize_t count) {
    View mean, cov, points, lower;
    if (count != 5 || !mean.open(given[0], 0, 1, false) || !cov.open(given[1], 0, 2, false) ||
        !points.open(given[3], 2, 0, true) ||
        (given[4] != Py_None && !lower.open(given[4], 2, 0, true)))
        return nullptr;
    const Py_ssize_t n = points.length(0);
    const bool keep = given[4] != Py_None;
    if (!of_size<Spread>(n, mean, cov, PyFloat_AsDouble(given[2]), points, lower, keep))
        return too_large(n, 0);
    Py_RETURN_NONE;
}

PyObject *moments(PyObject *, PyObject *const *given, Py_ssize_t count) {
    View first, away, noise, mean, cov;
    if (count != 8 || !first.open(given[0], 0, 1, false) || !away.open(given[1], 1, 1, false) ||
        !noise.open(given[5], 0, 2, false) || !mean.open(given[6], 1, 0, true) ||
        !cov.open(given[7], 2, 0, true))
        return nullptr;
    const Py_ssize_t m = mean.length(0);
    const bool plain = given[2] == Py_True;
    const double weight = PyFloat_AsDouble(given[3]), curvature = PyFloat_AsDouble(given[4]);
    if (!of_size<Moments>(m, first, away, plain, weight, curvature, noise, mean, cov))
        return too_large(m, 0);
    Py_RETURN_NONE;
}

PyObject *expect(PyObject *, PyObject *const *given, Py_ssize_t count) {
    View first, away, noise, lower, mean, cov, covs;
    if (count != 11 || !first.open(given[0], 0, 1, false) || !away.open(given[1], 1, 1, false) ||
        !noise.open(given[5], 0, 2, false) || !lower.open(given[6], 2, 0, false) ||
        !mean.open(given[8], 1, 0, true) || !cov.open(given[9], 2, 0, true) ||
        !covs.open(given[10], 2, 0, true))
        return nullptr;
    const Py_ssize_t n = covs.length(0), m = covs.length(1);
    const bool plain = given[2] == Py_True;
    const double weight = PyFloat_AsDouble(given[3]), curvature = PyFloat_AsDouble(given[4]);
    const double scale = PyFloat_AsDouble(given[7]);
    if (!of_sizes<Expect>(n, m, first, away, plain, weight, curvature, noise, lower, scale, mean,
                          cov, covs))
        return too_large(n, m);
    Py_RETURN_NONE;
}

PyObject *correct(PyObject *, PyObject *const *given, Py_ssize_t count) {
    View mean, cov, innovation, innovation_cov, covs, mean_after, cov_after, squared;
    if (count != 8 || !mean.open(given[0], 0, 1, false) || !cov.open(given[1], 0, 2, false) ||
        !innovation.open(given[2], 0, 1, false) || !innovation_cov.open(given[3], 0, 2, false) ||
        !covs.open(given[4], 0, 2, false) || !mean_after.open(given[5], 1, 0, true) ||
        !cov_after.open(given[6], 2, 0, true) || !squared.open(given[7], 0, 0, true))
        return nullptr;
    const Py_ssize_t n = mean_after.length(0);
    const Py_ssize_t m = innovation.length(innovation.axes() - 1);
    if (!of_sizes<Correct>(n, m, mean, cov, innovation, innovation_cov, covs, mean_after, cov_after,
                           squared))
        return too_large(n, m);
    Py_RETURN_NONE;
}

PyObject *informed(PyObject *, PyObject *const *given, Py_ssize_t count) {
    View mean, cov, numbers, sharpness;
    if (count != 4 || !mean.open(given[0], 0, 1, false) || !cov.open(given[1], 0, 2, false) ||
        !numbers.open(given[2], 1, 0, true) || !sharpness.open(given[3], 0, 0, true))
        return nullptr;
    const Py_ssize_t n = mean.length(mean.axes() - 1);
    if (!of_size<Informed>(n, mean, cov, numbers, sharpness)) return too_large(n, 0);
    Py_RETURN_NONE;
}

PyObject *concluded(PyObject *, PyObject *const *given, Py_ssize_t count) {
    View numbers, mean, cov;
    if (count != 3 || !numbers.open(given[0], 0, 1, false) || !mean.open(given[1], 1, 0, true) ||
        !cov.open(given[2], 2, 0, true))
        return nullptr;
    const Py_ssize_t n = mean.length(0);
    if (!of_size<Concluded>(n, numbers, mean, cov)) return too_large(n, 0);
    Py_RETURN_NONE;
}

PyObject *fused(PyObject *, PyObject *const *given, Py_ssize_t count) {
    View own_mean, own_cov, mean, cov, weights, mean_after, cov_after, used, sharpness;
    if (count != 10 || !own_mean.open(given[0], 0, 1, false) ||
        !own_cov.open(given[1], 0, 2, false) || !mean.open(given[2], 0, 1, false) ||
        !cov.open(given[3], 0, 2, false) || !weights.open(given[4], 0, 0, false) ||
        !mean_after.open(given[6], 1, 0, true) || !cov_after.open(given[7], 2, 0, true) ||
        !used.open(given[8], 0, 0, true) || !sharpness.open(given[9], 0, 0, true))
        return nullptr;
    const Py_ssize_t n = mean_after.length(0);
    const bool by_sharpness = given[5] == Py_True;
    if (!of_size<Fused>(n, own_mean, own_cov, mean, cov, weights, by_sharpness, mean_after,
                        cov_after, used, sharpness))
        return too_large(n, 0);
    Py_RETURN_NONE;
}

PyObject *sharpness(PyObject *, PyObject *const *given, Py_ssize_t count) {
    View triangle, result;
    if (count != 3 || !triangle.open(given[0], 0, 1, false) || !result.open(given[2], 0, 0, true))
        return nullptr;
    const Py_ssize_t n = PyLong_AsSsize_t(given[1]);
    if (!of_size<Sharpness>(n, triangle, result)) return too_large(n, 0);
    Py_RETURN_NONE;
}

template <template <int> class Run>
PyObject *on_matrices(PyObject *, PyObject *const *given, Py_ssize_t count) {
    View matrix, result;
    if (count != 2 || !matrix.open(given[0], 0, 2, false) || !result.open(given[1], 2, 0, true))
        return nullptr;
    const Py_ssize_t n = result.length(0);
    if (!of_size<Run>(n, matrix, result)) return too_large(n, 0);
    Py_RETURN_NONE;
}

template <PyObject *(*function)(PyObject *, PyObject *const *, Py_ssize_t)> PyCFunction fast() {
    return reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(function));
}

PyMethodDef methods[] = {
    {"spread", fast<spread>(), METH_FASTCALL, "mean, cov, reach -> points, lower (or None)"},
    {"moments", fast<moments>(), METH_FASTCALL,
     "first, away, plain, weight, curvature, noise -> mean, cov"},
    {"expect", fast<expect>(), METH_FASTCALL,
     "first, away, plain, weight, curvature, noise, lower, scale -> mean, cov, cross_cov"},
    {"correct", fast<correct>(), METH_FASTCALL,
     "mean, cov, innovation, innovation_cov, cross_cov -> mean, cov, squared"},
    {"cholesky", fast<on_matrices<Factor>>(), METH_FASTCALL, "matrix -> lower"},
    {"inverse_spd", fast<on_matrices<Inverse>>(), METH_FASTCALL, "matrix -> inverse"},
    {"informed", fast<informed>(), METH_FASTCALL, "mean, cov -> packed information, sharpness"},
    {"concluded", fast<concluded>(), METH_FASTCALL, "packed information -> mean, cov"},
    {"fused", fast<fused>(), METH_FASTCALL,
     "own mean and cov, means, covs, weights, by_sharpness -> mean, cov, used, sharpness"},
    {"sharpness", fast<sharpness>(), METH_FASTCALL, "packed triangle, states -> |M|^(-1/n)"},
    {nullptr, nullptr, 0, nullptr},
};

PyModuleDef module = {PyModuleDef_HEAD_INIT, "concord_fast", nullptr, -1, methods};

}  // namespace

PyMODINIT_FUNC PyInit_concord_fast() {
    PyObject *self = PyModule_Create(&module);
    if (self && (PyModule_AddIntConstant(self, "STATES", STATES) ||
                 PyModule_AddIntConstant(self, "READINGS", READINGS) ||
                 PyModule_AddIntConstant(self, "INTERFACE", INTERFACE)))
        return nullptr;
    return self;
}
