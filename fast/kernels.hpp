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

// Lower triangle into its factor, or NaN in all of it.
template <int N> inline void complete(Vector (&rows)[N][N]) {
    eliminate<N, N>(rows);
    // The last pivot minus itself is NaN or 0.
    const Vector lost = rows[N - 1][N - 1] - rows[N - 1][N - 1];
    for (int i = 0; i < N; ++i)
        for (int j = 0; j <= i; ++j) rows[i][j] += lost;
}

template <int N, class Array>
inline void factor(const Array &matrix, Py_ssize_t lane, Vector (&rows)[N][N]) {
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

// All that is expected of a measurement. Apart, the two take half the time of one that loads `away`
// once: so many arrays have more addresses than there are registers.
template <int N, int M> struct Expect {
    static void run(const View &first, const View &away, bool plain, double weight,
                    double curvature, const View &noise, const View &lower, double scale,
                    const View &mean, const View &cov, const View &cross) {
        Moments<M>::run(first, away, plain, weight, curvature, noise, mean, cov);
        Cross<N, M>::run(lower, away, scale, cross);
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

// Inverse of symmetric positive definite matrices.
template <int N> struct Inverse {
    static void run(const View &matrix, const View &inverse) {
        const auto block = [&](Py_ssize_t lane, const auto &matrix, const auto &inverse) {
            Vector rows[N][N], result[N][N];
            factor<N>(matrix, lane, rows);
            invert<N>(rows, result);
            for (int i = 0; i < N; ++i)
                for (int j = 0; j <= i; ++j) {
                    inverse.store(result[i][j], lane, i, j);
                    if (j < i) inverse.store(result[i][j], lane, j, i);
                }
        };
        over_lanes(matrix.lanes(), block, matrix, inverse);
    }
};

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

// Packed information of beliefs, vector first, and the sharpness |P|^(-1/N).
template <int N> struct Informed {
    static void run(const View &mean, const View &cov, const View &numbers,
                    const View &sharpness) {
        const auto block = [&](Py_ssize_t lane, const auto &mean, const auto &cov,
                               const auto &numbers, const auto &sharpness) {
            Vector rows[N][N], matrix[N][N], offset[N], vector[N], pivots[N];
            factor<N>(cov, lane, rows);
            invert<N>(rows, matrix);
            for (int i = 0; i < N; ++i) {
                offset[i] = mean.load(lane, i);
                pivots[i] = rows[i][i] * rows[i][i];
            }
            multiply<N>(matrix, offset, vector);
            for (int i = 0; i < N; ++i) {
                numbers.store(vector[i], lane, i);
                for (int j = 0; j <= i; ++j)
                    numbers.store(matrix[i][j], lane, N + packed<N>(i, j));
            }
            sharpness.store(inverse_geometric_mean<N>(pivots), lane);
        };
        over_lanes(sharpness.lanes(), block, mean, cov, numbers, sharpness);
    }
};

// Beliefs of packed information.
template <int N> struct Concluded {
    static void run(const View &numbers, const View &mean, const View &cov) {
        const auto block = [&](Py_ssize_t lane, const auto &numbers, const auto &mean,
                               const auto &cov) {
            Vector rows[N][N], matrix[N][N], vector[N], result[N];
            for (int i = 0; i < N; ++i) {
                vector[i] = numbers.load(lane, i);
                for (int j = 0; j <= i; ++j)
                    rows[i][j] = numbers.load(lane, N + packed<N>(i, j));
            }
            complete<N>(rows);
            invert<N>(rows, matrix);
            multiply<N>(matrix, vector, result);
            for (int i = 0; i < N; ++i) {
                mean.store(result[i], lane, i);
                for (int j = 0; j <= i; ++j) {
                    cov.store(matrix[i][j], lane, i, j);
                    if (j < i) cov.store(matrix[i][j], lane, j, i);
                }
            }
        };
        over_lanes(mean.lanes(), block, numbers, mean, cov);
    }
};

// |M|^(-1/N) of packed matrices M, the pivots of M = L D L' being all that it takes.
template <int N> struct Sharpness {
    static void run(const View &triangle, const View &sharpness) {
        const auto block = [&](Py_ssize_t lane, const auto &triangle, const auto &sharpness) {
            Vector rows[N][N], pivots[N];
            for (int i = 0; i < N; ++i)
                for (int j = 0; j <= i; ++j) rows[i][j] = triangle.load(lane, packed<N>(i, j));
            for (int j = 0; j < N; ++j) {
                pivots[j] = rows[j][j];
                const Vector scale = 1.0 / pivots[j];
                for (int i = j + 1; i < N; ++i) {
                    const Vector part = rows[i][j] * scale;
                    for (int k = j + 1; k <= i; ++k) rows[i][k] -= part * rows[k][j];
                }
            }
            sharpness.store(inverse_geometric_mean<N>(pivots), lane);
        };
        over_lanes(sharpness.lanes(), block, triangle, sharpness);
    }
};
