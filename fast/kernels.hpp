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

// Lower triangle of a symmetric matrix into its Cholesky factor, in place; further rows b become
// b C^-T. From a pivot that is not positive on the lane is NaN.
template <int N, int ROWS> inline void eliminate(Vector (&rows)[ROWS][N]) {
    for (int j = 0; j < N; ++j) {
        Vector pivot = rows[j][j];
        for (int k = 0; k < j; ++k) pivot -= rows[j][k] * rows[j][k];
        pivot = root(pivot);
        rows[j][j] = pivot;
        const Vector scale = 1.0 / pivot;
        for (int i = j + 1; i < ROWS; ++i) {
            Vector value = rows[i][j];
            for (int k = 0; k < j; ++k) value -= rows[i][k] * rows[j][k];
            rows[i][j] = value * scale;
        }
    }
}

template <int N, class Array>
inline void factor(const Array &matrix, Py_ssize_t lane, Vector (&rows)[N][N]) {
    for (int i = 0; i < N; ++i)
        for (int j = 0; j <= i; ++j) rows[i][j] = matrix.load(lane, i, j);
    eliminate<N, N>(rows);
    // NaN in all of it: the last pivot minus itself is NaN or 0.
    const Vector lost = rows[N - 1][N - 1] - rows[N - 1][N - 1];
    for (int i = 0; i < N; ++i)
        for (int j = 0; j <= i; ++j) rows[i][j] += lost;
}

// Points on the axes, mean +- reach C, after the centre if there is one; and C, lower triangle.
template <int N> struct Spread {
    static void run(const View &mean, const View &cov, double reach, const View &points,
                    const View &lower, bool keep) {
        const int centre = points.length(1) - 2 * N;
        const auto block = [&](Py_ssize_t lane, const auto &mean, const auto &cov,
                               const auto &points, const auto &lower) {
            Vector rows[N][N];
            factor<N>(cov, lane, rows);
            const Vector lost = rows[0][0] - rows[0][0];
            for (int i = 0; i < N; ++i) {
                const Vector middle = mean.load(lane, i) + lost;
                if (centre) points.store(middle, lane, i, 0);
                for (int j = 0; j < N; ++j) {
                    const Vector offset = j <= i ? reach * rows[i][j] : Vector{};
                    points.store(middle + offset, lane, i, centre + j);
                    points.store(middle - offset, lane, i, centre + N + j);
                    if (keep && j <= i) lower.store(rows[i][j], lane, i, j);
                }
            }
        };
        over_lanes(mean.lanes(), block, mean, cov, points, lower);
    }
};

// Mean and covariance of differences to a first value, see filters.sigma_points; `plain` says that
// `away` holds values from which the first is still to be subtracted.
template <int M> struct Moments {
    static void run(const View &first, const View &away, bool plain, double weight,
                    double curvature, const View &noise, const View &mean, const View &cov) {
        const Py_ssize_t count = away.length(0);
        const auto block = [&](Py_ssize_t lane, const auto &first, const auto &away,
                               const auto &noise, const auto &mean, const auto &cov) {
            Vector begin[M], shift[M] = {}, sum[M][M] = {};
            for (int i = 0; i < M; ++i) begin[i] = first.load(lane, i);
            for (Py_ssize_t s = 0; s < count; ++s) {
                Vector row[M];
                for (int i = 0; i < M; ++i) {
                    row[i] = away.load(lane, s, i);
                    if (plain) row[i] -= begin[i];
                    shift[i] += row[i];
                }
                for (int i = 0; i < M; ++i)
                    for (int j = 0; j <= i; ++j) sum[i][j] += row[i] * row[j];
            }
            for (int i = 0; i < M; ++i) shift[i] *= weight;
            for (int i = 0; i < M; ++i) {
                mean.store(begin[i] + shift[i], lane, i);
                for (int j = 0; j <= i; ++j) {
                    const Vector value = weight * sum[i][j] + curvature * shift[i] * shift[j] +
                                         noise.load(lane, i, j);
                    cov.store(value, lane, i, j);
                    if (j < i) cov.store(value, lane, j, i);
                }
            }
        };
        over_lanes(mean.lanes(), block, first, away, noise, mean, cov);
    }
};

// Covariance (N, M) of the state with what was predicted: reach weight C (D+ - D-).
template <int N, int M> struct Cross {
    static void run(const View &lower, const View &away, double scale, const View &cross) {
        const auto block = [&](Py_ssize_t lane, const auto &lower, const auto &away,
                               const auto &cross) {
            Vector halves[N][M];
            for (int j = 0; j < N; ++j)
                for (int k = 0; k < M; ++k)
                    halves[j][k] = scale * (away.load(lane, j, k) - away.load(lane, N + j, k));
            for (int i = 0; i < N; ++i) {
                Vector sums[M] = {};
                for (int j = 0; j <= i; ++j) {
                    const Vector entry = lower.load(lane, i, j);
                    for (int k = 0; k < M; ++k) sums[k] += entry * halves[j][k];
                }
                for (int k = 0; k < M; ++k) cross.store(sums[k], lane, i, k);
            }
        };
        over_lanes(cross.lanes(), block, lower, away, cross);
    }
};

// The belief given an innovation v: with S = C C' and G = P_xz C^-T, x + G C^-1 v and P - G G'.
template <int N, int M> struct Correct {
    static void run(const View &mean, const View &cov, const View &innovation,
                    const View &innovation_cov, const View &cross, const View &mean_after,
                    const View &cov_after, const View &squared) {
        const auto block = [&](Py_ssize_t lane, const auto &mean, const auto &cov,
                               const auto &innovation, const auto &innovation_cov,
                               const auto &cross, const auto &mean_after, const auto &cov_after,
                               const auto &squared) {
            Vector rows[M + N + 1][M];
            for (int k = 0; k < M; ++k) {
                for (int i = k; i < M; ++i) rows[i][k] = innovation_cov.load(lane, i, k);
                for (int i = 0; i < N; ++i) rows[M + i][k] = cross.load(lane, i, k);
                rows[M + N][k] = innovation.load(lane, k);
            }
            eliminate<M, M + N + 1>(rows);
            Vector sum = {};
            for (int k = 0; k < M; ++k) sum += rows[M + N][k] * rows[M + N][k];
            squared.store(sum, lane);
            for (int i = 0; i < N; ++i) {
                Vector after = mean.load(lane, i);
                for (int k = 0; k < M; ++k) after += rows[M + i][k] * rows[M + N][k];
                mean_after.store(after, lane, i);
                for (int j = 0; j <= i; ++j) {
                    Vector value = cov.load(lane, i, j);
                    for (int k = 0; k < M; ++k) value -= rows[M + i][k] * rows[M + j][k];
                    cov_after.store(value, lane, i, j);
                    if (j < i) cov_after.store(value, lane, j, i);
                }
            }
        };
        over_lanes(mean.lanes(), block, mean, cov, innovation, innovation_cov, cross, mean_after, cov_after, squared);
    }
};

template <int N> struct Factor {
    static void run(const View &matrix, const View &lower) {
        const auto block = [&](Py_ssize_t lane, const auto &matrix, const auto &lower) {
            Vector rows[N][N];
            factor<N>(matrix, lane, rows);
            const Vector lost = rows[0][0] - rows[0][0];
            for (int i = 0; i < N; ++i)
                for (int j = 0; j < N; ++j) lower.store(j <= i ? rows[i][j] : lost, lane, i, j);
        };
        over_lanes(matrix.lanes(), block, matrix, lower);
    }
};

// Inverse of symmetric positive definite matrices: C^-T C^-1.
template <int N> struct Inverse {
    static void run(const View &matrix, const View &inverse) {
        const auto block = [&](Py_ssize_t lane, const auto &matrix, const auto &inverse) {
            Vector rows[N][N], back[N][N];
            factor<N>(matrix, lane, rows);
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
                    inverse.store(sum, lane, i, j);
                    if (j < i) inverse.store(sum, lane, j, i);
                }
        };
        over_lanes(matrix.lanes(), block, matrix, inverse);
    }
};
