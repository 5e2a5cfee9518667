// The compiled kernel of concord: how a node averages beliefs as information. The number of states
// is a compile-time constant, up to 8. The only caller is filters/kernels/compiled.py.
#include "fused.hpp"

namespace {

constexpr Py_ssize_t STATES = 8;
// Grows with every change of what filters/kernels/compiled.py calls.
constexpr long INTERFACE = 5;

PyObject *too_large(Py_ssize_t n) {
    return PyErr_Format(PyExc_ValueError, "no kernel for %zd states: there are up to %zd", n,
                        STATES);
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
        return too_large(n);
    Py_RETURN_NONE;
}

template <PyObject *(*function)(PyObject *, PyObject *const *, Py_ssize_t)> PyCFunction fast() {
    return reinterpret_cast<PyCFunction>(reinterpret_cast<void (*)()>(function));
}

PyMethodDef methods[] = {
    {"fused", fast<fused>(), METH_FASTCALL,
     "own mean and cov, means, covs, weights, by_sharpness -> mean, cov, used, sharpness"},
    {nullptr, nullptr, 0, nullptr},
};

PyModuleDef module = {PyModuleDef_HEAD_INIT, "concord_fast", nullptr, -1, methods};

}  // namespace

PyMODINIT_FUNC PyInit_concord_fast() {
    PyObject *self = PyModule_Create(&module);
    if (self && (PyModule_AddIntConstant(self, "STATES", STATES) ||
                          PyModule_AddIntConstant(self, "INTERFACE", INTERFACE)))
        return nullptr;
    return self;
}
