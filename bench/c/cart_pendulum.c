/* The criterion of the cart-pendulum along the nominal trajectory: what shared_control.mig computes, by hand. */
#include <math.h>

#define N 4
#define MAX_STEPS 6000
static double nodes[MAX_STEPS + 1][N], partial[MAX_STEPS][4][2];

static double wrap(double a)
{
    if (-M_PI < a && a <= M_PI) return a;
    double rest = fmod(fabs(a), 2.0 * M_PI);
    if (rest > M_PI) rest -= 2.0 * M_PI;
    return a > 0.0 || rest == M_PI ? rest : -rest;
}

typedef struct { double gravity, length, friction; } Pendulum;

static void stage(const Pendulum *p, const double *x, double u, double *f, double *d)
{
    double s = sin(x[0]), c = cos(x[0]);
    f[0] = x[1];
    f[1] = (p->gravity * s - u * c) / p->length - p->friction * x[1];
    f[2] = x[3];
    f[3] = u;
    d[0] = (p->gravity * c + u * s) / p->length;
    d[1] = -c / p->length;
}

static double back(const Pendulum *p, const double *d, const double *w, double *out)
{
    out[0] = d[0] * w[1];
    out[1] = w[0] - p->friction * w[1];
    out[2] = 0.0;
    out[3] = w[2];
    return d[1] * w[1] + w[3];
}

double criterion(const double *physics, const double *q, const double *target, const double *start, const double *user,
                 double h, int steps)
{
    Pendulum p = {physics[2], physics[3], physics[1] / (physics[0] * physics[3] * physics[3])};
    double x[N], y[N], k[4][N], rho[N], w[N], s[4][N], rho_u = 0.0;
    int i, t;
    for (i = 0; i < N; i++) x[i] = start[i];
    for (t = 0; t < steps; t++) {
        for (i = 0; i < N; i++) nodes[t][i] = x[i];
        stage(&p, x, 0.0, k[0], partial[t][0]);
        for (i = 0; i < N; i++) y[i] = x[i] + 0.5 * h * k[0][i];
        stage(&p, y, 0.0, k[1], partial[t][1]);
        for (i = 0; i < N; i++) y[i] = x[i] + 0.5 * h * k[1][i];
        stage(&p, y, 0.0, k[2], partial[t][2]);
        for (i = 0; i < N; i++) y[i] = x[i] + h * k[2][i];
        stage(&p, y, 0.0, k[3], partial[t][3]);
        for (i = 0; i < N; i++) x[i] += h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
    }
    for (i = 0; i < N; i++) rho[i] = 0.5 * h * q[i] * (i == 0 ? wrap(x[0] - target[0]) : x[i] - target[i]);
    for (t = steps - 1; t >= 0; t--) {
        double u4, u3, u2, u1;
        for (i = 0; i < N; i++) w[i] = h / 6.0 * rho[i];
        u4 = back(&p, partial[t][3], w, s[3]);
        for (i = 0; i < N; i++) w[i] = h / 3.0 * rho[i] + h * s[3][i];
        u3 = back(&p, partial[t][2], w, s[2]);
        for (i = 0; i < N; i++) w[i] = h / 3.0 * rho[i] + 0.5 * h * s[2][i];
        u2 = back(&p, partial[t][1], w, s[1]);
        for (i = 0; i < N; i++) w[i] = h / 6.0 * rho[i] + 0.5 * h * s[1][i];
        u1 = back(&p, partial[t][0], w, s[0]);
        rho_u = u1 + u2 + u3 + u4;
        for (i = 0; i < N; i++) rho[i] += s[0][i] + s[1][i] + s[2][i] + s[3][i];
        if (t > 0)
            for (i = 0; i < N; i++) rho[i] += h * q[i] * (i == 0 ? wrap(nodes[t][0] - target[0]) : nodes[t][i] - target[i]);
    }
    return rho_u * user[0];
}

/* One after the other for many states (count, N), without a caller between them. */
void criteria(const double *physics, const double *q, const double *target, const double *starts, const double *user,
              double h, int steps, int count, double *values)
{
    for (int k = 0; k < count; k++) values[k] = criterion(physics, q, target, starts + k * N, user, h, steps);
}
