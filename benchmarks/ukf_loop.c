/* One unscented filter step for each of many filters, models included: what a loop in C costs.
   Weights of Merwe's rule with alpha 1, beta 2, kappa 3 - n; points are drawn again before the
   update. A macro, so that the number of states is known where it is compiled. */
#include <math.h>

#define M 2

static void straight_f(double *x) {
    x[0] += x[1];
    x[2] += x[3];
}

static void straight_h(const double *x, double *z) {
    z[0] = x[0];
    z[1] = x[2];
}

static void turn_f(double *x) {
    const double w = x[4], s = sin(w), c = cos(w), a = s / w, b = (1 - c) / w;
    const double vx = x[1], vy = x[3];
    x[0] += a * vx - b * vy;
    x[1] = c * vx - s * vy;
    x[2] += b * vx + a * vy;
    x[3] = s * vx + c * vy;
}

static void turn_h(const double *x, double *z) {
    const double dx = x[0] + 150.0, dy = x[2] - 80.0;
    z[0] = sqrt(dx * dx + dy * dy);
    z[1] = atan2(dy, dx);
}

static double same(double d) { return d; }

static double wrapped(double d) { return d - 2 * M_PI * ceil(d / (2 * M_PI) - 0.5); }

#define STEP(NAME, N, MOVE, SEE, WRAP)                                                             \
    static void NAME##_points(const double *x, const double *P, double X[2 * N + 1][N]) {          \
        double L[N][N];                                                                            \
        for (int j = 0; j < N; ++j) {                                                              \
            double pivot = P[j * N + j];                                                           \
            for (int k = 0; k < j; ++k) pivot -= L[j][k] * L[j][k];                                \
            L[j][j] = sqrt(pivot);                                                                 \
            for (int i = j + 1; i < N; ++i) {                                                      \
                double entry = P[i * N + j];                                                       \
                for (int k = 0; k < j; ++k) entry -= L[i][k] * L[j][k];                            \
                L[i][j] = entry / L[j][j];                                                         \
            }                                                                                      \
        }                                                                                          \
        for (int i = 0; i < N; ++i) X[0][i] = x[i];                                                \
        for (int j = 0; j < N; ++j)                                                                \
            for (int i = 0; i < N; ++i) {                                                          \
                const double away = i < j ? 0.0 : 1.7320508075688772 * L[i][j];                    \
                X[1 + j][i] = x[i] + away;                                                         \
                X[1 + N + j][i] = x[i] - away;                                                     \
            }                                                                                      \
    }                                                                                              \
    void NAME(long lanes, double *means, double *covs, const double *Q, const double *R,           \
              const double *readings) {                                                            \
        const double w = 1.0 / 6, w0 = 1.0 - N / 3.0, c0 = w0 + 2.0;                               \
        for (long lane = 0; lane < lanes; ++lane) {                                                \
            double *x = means + lane * N, *P = covs + lane * N * N, X[2 * N + 1][N];               \
            NAME##_points(x, P, X);                                                                \
            for (int s = 0; s < 2 * N + 1; ++s) MOVE(X[s]);                                        \
            for (int i = 0; i < N; ++i) {                                                          \
                x[i] = w0 * X[0][i];                                                               \
                for (int s = 1; s < 2 * N + 1; ++s) x[i] += w * X[s][i];                           \
            }                                                                                      \
            for (int i = 0; i < N; ++i)                                                            \
                for (int j = 0; j <= i; ++j) {                                                     \
                    double sum = Q[i * N + j];                                                     \
                    for (int s = 0; s < 2 * N + 1; ++s)                                            \
                        sum += (s ? w : c0) * (X[s][i] - x[i]) * (X[s][j] - x[j]);                 \
                    P[i * N + j] = P[j * N + i] = sum;                                             \
                }                                                                                  \
            NAME##_points(x, P, X);                                                                \
            double Z[2 * N + 1][M], z[M] = {0}, S[M][M], C[N][M], K[N][M], v[M];                   \
            for (int s = 0; s < 2 * N + 1; ++s) SEE(X[s], Z[s]);                                   \
            for (int i = 0; i < M; ++i) {                                                          \
                for (int s = 1; s < 2 * N + 1; ++s)                                                \
                    z[i] += w * (i ? WRAP(Z[s][i] - Z[0][i]) : Z[s][i] - Z[0][i]);                 \
                z[i] += Z[0][i];                                                                   \
            }                                                                                      \
            for (int s = 0; s < 2 * N + 1; ++s) {                                                  \
                Z[s][0] -= z[0];                                                                   \
                Z[s][1] = WRAP(Z[s][1] - z[1]);                                                    \
            }                                                                                      \
            for (int i = 0; i < M; ++i)                                                            \
                for (int j = 0; j < M; ++j) {                                                      \
                    S[i][j] = R[i * M + j];                                                        \
                    for (int s = 0; s < 2 * N + 1; ++s) S[i][j] += (s ? w : c0) * Z[s][i] * Z[s][j]; \
                }                                                                                  \
            for (int i = 0; i < N; ++i)                                                            \
                for (int j = 0; j < M; ++j) {                                                      \
                    C[i][j] = 0;                                                                   \
                    for (int s = 1; s < 2 * N + 1; ++s) C[i][j] += w * (X[s][i] - x[i]) * Z[s][j];   \
                }                                                                                  \
            const double det = S[0][0] * S[1][1] - S[0][1] * S[1][0];                              \
            v[0] = readings[lane * M] - z[0];                                                      \
            v[1] = WRAP(readings[lane * M + 1] - z[1]);                                            \
            for (int i = 0; i < N; ++i) {                                                          \
                K[i][0] = (C[i][0] * S[1][1] - C[i][1] * S[1][0]) / det;                           \
                K[i][1] = (C[i][1] * S[0][0] - C[i][0] * S[0][1]) / det;                           \
            }                                                                                      \
            for (int i = 0; i < N; ++i) {                                                          \
                x[i] += K[i][0] * v[0] + K[i][1] * v[1];                                           \
                for (int j = 0; j <= i; ++j)                                                       \
                    P[j * N + i] = P[i * N + j] -= K[i][0] * C[j][0] + K[i][1] * C[j][1];          \
            }                                                                                      \
        }                                                                                          \
    }

STEP(straight, 4, straight_f, straight_h, same)
STEP(turn, 5, turn_f, turn_h, wrapped)
