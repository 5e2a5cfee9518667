// What a node makes of its own belief and those of others: an average of information.
#pragma once

#include "kernels.hpp"

// Sums over beliefs, which lie in the lanes, of worth and of worth times packed information about
// an origin.
template <int N> struct Sums {
    static constexpr int LENGTH = N * (N + 3) / 2;
    double numbers[LENGTH] = {}, worth = 0.0, origin[N];

    // Adds beliefs whose weights begin at `place`, and keeps their worth and their sharpness.
    void add(const View &mean, const View &cov, const View &weights, bool by_sharpness,
             Py_ssize_t place, const View &used, const View &sharpness) {
        for (Py_ssize_t lane = 0; lane < mean.lanes(); lane += WIDTH) {
            Vector rows[N][N], matrix[N][N], offset[N], vector[N], pivots[N];
            factor<N>(cov, lane, rows);
            invert<N>(rows, matrix);
            for (int i = 0; i < N; ++i) {
                offset[i] = mean.load(lane, i) - origin[i];
                pivots[i] = rows[i][i] * rows[i][i];
            }
            multiply<N>(matrix, offset, vector);
            const Vector sharp = inverse_geometric_mean<N>(pivots);
            Vector value = weights.load(place + lane);
            if (by_sharpness) value = value > 0.0 ? value * sharp : Vector{};
            used.store(value, place + lane);
            sharpness.store(sharp, place + lane);
            for (Py_ssize_t k = 0; k < WIDTH && lane + k < mean.lanes(); ++k) {
                // What weighs nothing may be anything, NaN included.
                if (value[k] == 0.0) continue;
                worth += value[k];
                for (int i = 0; i < N; ++i) {
                    numbers[i] += value[k] * vector[i][k];
                    for (int j = 0; j <= i; ++j)
                        numbers[N + packed<N>(i, j)] += value[k] * matrix[i][j][k];
                }
            }
        }
    }
};

template <int N> struct Fused {
    static void run(const View &own_mean, const View &own_cov, const View &mean, const View &cov,
                    const View &weights, bool by_sharpness, const View &mean_after,
                    const View &cov_after, const View &used, const View &sharpness) {
        Sums<N> sums;
        for (int i = 0; i < N; ++i) sums.origin[i] = own_mean.load(0, i)[0];
        sums.add(own_mean, own_cov, weights, by_sharpness, 0, used, sharpness);
        sums.add(mean, cov, weights, by_sharpness, 1, used, sharpness);
        const double scale = by_sharpness ? 1.0 / sums.worth : 1.0;
        for (Py_ssize_t lane = 0; by_sharpness && lane < used.lanes(); lane += WIDTH)
            used.store(used.load(lane) * scale, lane);
        Vector rows[N][N], matrix[N][N], vector[N], offset[N];
        for (int i = 0; i < N; ++i) {
            vector[i] = Vector{} + scale * sums.numbers[i];
            for (int j = 0; j <= i; ++j)
                rows[i][j] = Vector{} + scale * sums.numbers[N + packed<N>(i, j)];
        }
        complete<N>(rows);
        invert<N>(rows, matrix);
        multiply<N>(matrix, vector, offset);
        for (int i = 0; i < N; ++i) {
            mean_after.store(sums.origin[i] + offset[i], 0, i);
            for (int j = 0; j < N; ++j)
                cov_after.store(j <= i ? matrix[i][j] : matrix[j][i], 0, i, j);
        }
    }
};
