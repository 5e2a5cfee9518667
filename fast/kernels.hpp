// What is done to WIDTH lanes at once. A lane that fails is NaN, and fails alone.
#pragma once

#include <cmath>
#include <limits>

#include "views.hpp"

inline Vector root(Vector value) {
    // Zero and less have no factor: a square root alone would let zero pass.
    const Vector lost = Vector{} + std::numeric_limits<double>::quiet_NaN();
    value = value > 0.0 ? value : lost;
    for (int k = 0; k < WIDTH; ++k) value[k] = __builtin_sqrt(value[k]);
    return value;
}

// 2^exponent of whole numbers that a double has as exponents.
inline Vector power_of_two(Vector exponent) {
    return (Vector)((__builtin_convertvector(exponent, Bits) + 1023) << 52);
}

// Lower triangle of a symmetric matrix into its Cholesky factor, in place. From a pivot that is not
// positive on the lane is NaN.
template <int N> inline void eliminate(Vector (&rows)[N][N]) {
    for (int j = 0; j < N; ++j) {
        Vector pivot = rows[j][j];
        for (int k = 0; k < j; ++k) pivot -= rows[j][k] * rows[j][k];
        pivot = root(pivot);
        rows[j][j] = pivot;
        const Vector scale = 1.0 / pivot;
        for (int i = j + 1; i < N; ++i) {
            Vector value = rows[i][j];
            for (int k = 0; k < j; ++k) value -= rows[i][k] * rows[j][k];
            rows[i][j] = value * scale;
        }
    }
}

// Lower triangle into its factor, or NaN in all of it.
template <int N> inline void complete(Vector (&rows)[N][N]) {
    eliminate<N>(rows);
    // The last pivot minus itself is NaN or 0.
    const Vector lost = rows[N - 1][N - 1] - rows[N - 1][N - 1];
    for (int i = 0; i < N; ++i)
        for (int j = 0; j <= i; ++j) rows[i][j] += lost;
}

template <int N>
inline void factor(const View &matrix, Py_ssize_t lane, Vector (&rows)[N][N]) {
    for (int i = 0; i < N; ++i)
        for (int j = 0; j <= i; ++j) rows[i][j] = matrix.load(lane, i, j);
    complete<N>(rows);
}

// (p_1 ... p_N)^(-1/N) of positive pivots; NaN where one is not, or is infinite.
//
// The product itself could overflow: exponents are added up apart from it. With it brought to
// m 2^(q N + r), 1 <= m < 2, 0 <= r < N, the root of m 2^r lies between 1 and 2, and Newton's
// iteration for its inverse y doubles its digits from two in every turn.
template <int N> inline Vector inverse_geometric_mean(const Vector (&pivots)[N]) {
    constexpr long long ONE = 1023, SHIFT = 52, MANTISSA = (1LL << SHIFT) - 1;
    Vector product = Vector{} + 1.0, lost = {};
    Bits exponent = {};
    for (int i = 0; i <= N; ++i) {
        if (i < N) {
            const Vector nan = Vector{} + std::numeric_limits<double>::quiet_NaN();
            lost += pivots[i] > 0.0 ? pivots[i] - pivots[i] : nan;
        }
        // Last of all the product of the mantissas itself.
        const Bits bits = (Bits)(i < N ? pivots[i] : product);
        exponent += (bits >> SHIFT) - ONE;
        const Vector mantissa = (Vector)((bits & MANTISSA) | (ONE << SHIFT));
        product = i < N ? product * mantissa : mantissa;
    }
    const Vector all = __builtin_convertvector(exponent, Vector);
    Vector whole = all / N;
    for (int k = 0; k < WIDTH; ++k) whole[k] = __builtin_floor(whole[k]);
    const Vector rest = all - N * whole;
    const Vector target = product * power_of_two(rest);
    Vector root = 1.0 - 0.5 * (rest + product - 1.0) / N;
    for (int turn = 0; turn < 5; ++turn) {
        Vector power = target * root;
        for (int i = 1; i < N; ++i) power *= root;
        root += root * (1.0 - power) / N;
    }
    return root * power_of_two(-whole) + lost;
}

// Inverse of the matrix that has these rows as its lower triangular factor, C^-T C^-1: its lower
// triangle.
template <int N> inline void invert(const Vector (&rows)[N][N], Vector (&inverse)[N][N]) {
    Vector back[N][N];
    for (int i = 0; i < N; ++i) {
        back[i][i] = 1.0 / rows[i][i];
        for (int j = 0; j < i; ++j) {
            Vector sum = {};
            for (int k = j; k < i; ++k) sum += rows[i][k] * back[k][j];
            back[i][j] = -sum * back[i][i];
        }
    }
    for (int i = 0; i < N; ++i)
        for (int j = 0; j <= i; ++j) {
            Vector sum = {};
            for (int k = i; k < N; ++k) sum += back[k][i] * back[k][j];
            inverse[i][j] = sum;
        }
}

// Matrix (lower triangle) times vector.
template <int N>
inline void multiply(const Vector (&matrix)[N][N], const Vector (&vector)[N],
                     Vector (&product)[N]) {
    for (int i = 0; i < N; ++i) {
        product[i] = Vector{};
        for (int j = 0; j < N; ++j)
            product[i] += (j <= i ? matrix[i][j] : matrix[j][i]) * vector[j];
    }
}

// Place of (i, j), j <= i, in an upper triangle packed row by row.
template <int N> constexpr int packed(int i, int j) { return j * N - j * (j - 1) / 2 + i - j; }
