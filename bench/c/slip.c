/* The criterion of SLIP along the user's trajectory, events located and differentiated: what shared_control.mig and
   shared_control.hybrid compute, by hand. */
#include <math.h>

#define N 5
#define M 2
#define EVENTS 3
#define MAX_STEPS 2000
#define ON_GUARD 1e-9
#define LOCATED 1e-14
#define GRAZING 1e-4
#define SHORTEST 1e-3
enum { FLIGHT, STANCE, FALLEN };

typedef struct { double mass, stiffness, rest, gravity, fall; } Slip;
typedef struct { int mode; double t, x[N], d[4][5]; } Segment;
static Segment segments[MAX_STEPS][EVENTS + 1];
static int counts[MAX_STEPS];
static double nodes[MAX_STEPS + 1][N];

static void stage(const Slip *p, int mode, const double *x, const double *u, double *f, double *d)
{
    int i;
    if (d)
        for (i = 0; i < 5; i++) d[i] = 0.0;
    for (i = 0; i < N; i++) f[i] = 0.0;
    if (mode == FALLEN) return;
    f[0] = x[1];
    f[2] = x[3];
    if (mode == FLIGHT) {
        f[3] = -p->gravity;
        f[4] = x[1] + u[1];
        return;
    }
    double along = x[0] - x[4];
    double leg = fmax(sqrt(along * along + x[2] * x[2]), SHORTEST * p->rest);
    double push = (p->stiffness * (p->rest - leg) + u[0]) / (p->mass * leg);
    f[1] = push * along;
    f[3] = push * x[2] - p->gravity;
    if (d) {
        double softer = -(p->stiffness * p->rest + u[0]) / (p->mass * leg * leg * leg);
        d[0] = push + softer * along * along;
        d[1] = softer * along * x[2];
        d[2] = push + softer * x[2] * x[2];
        d[3] = along / (p->mass * leg);
        d[4] = x[2] / (p->mass * leg);
    }
}

static void back(int mode, const double *d, const double *w, double *wx, double *wu)
{
    int i;
    for (i = 0; i < N; i++) wx[i] = 0.0;
    wu[0] = wu[1] = 0.0;
    if (mode == FALLEN) return;
    wx[3] = w[2];
    if (mode == FLIGHT) {
        wx[1] = w[0] + w[4];
        wu[1] = w[4];
        return;
    }
    wx[0] = d[0] * w[1] + d[1] * w[3];
    wx[1] = w[0];
    wx[2] = d[1] * w[1] + d[2] * w[3];
    wx[4] = -wx[0];
    wu[0] = d[3] * w[1] + d[4] * w[3];
}

static void rk4(const Slip *p, int mode, const double *x, const double *u, double h, double *end, double (*d)[5])
{
    double k1[N], k2[N], k3[N], k4[N], y[N];
    int i;
    stage(p, mode, x, u, k1, d ? d[0] : 0);
    for (i = 0; i < N; i++) y[i] = x[i] + 0.5 * h * k1[i];
    stage(p, mode, y, u, k2, d ? d[1] : 0);
    for (i = 0; i < N; i++) y[i] = x[i] + 0.5 * h * k2[i];
    stage(p, mode, y, u, k3, d ? d[2] : 0);
    for (i = 0; i < N; i++) y[i] = x[i] + h * k3[i];
    stage(p, mode, y, u, k4, d ? d[3] : 0);
    for (i = 0; i < N; i++) end[i] = x[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]);
}

static double guard(const Slip *p, int mode, const double *x)
{
    if (mode == FALLEN) return 1.0;
    double above = sqrt((x[0] - x[4]) * (x[0] - x[4]) + x[2] * x[2]) - p->rest;
    return mode == FLIGHT ? fmax(above, x[3]) : fmax(-above, -x[3]);
}

static void guard_gradient(const Slip *p, int mode, const double *x, double *n)
{
    int i;
    for (i = 0; i < N; i++) n[i] = 0.0;
    if (mode == FALLEN) return;
    double along = x[0] - x[4], leg = sqrt(along * along + x[2] * x[2]), sign = mode == FLIGHT ? 1.0 : -1.0;
    if (sign * x[3] >= sign * (leg - p->rest)) {
        n[3] = sign;
        return;
    }
    double scale = sign * fmax(leg, SHORTEST * p->rest);
    n[0] = along / scale;
    n[2] = x[2] / scale;
    n[4] = -along / scale;
}

static double rate(const Slip *p, int mode, const double *x, const double *u)
{
    double n[N], f[N], sum = 0.0;
    int i;
    guard_gradient(p, mode, x, n);
    stage(p, mode, x, u, f, 0);
    for (i = 0; i < N; i++) sum += n[i] * f[i];
    return sum;
}

static double guard_after(const Slip *p, int mode, const double *x, const double *u, double t)
{
    double y[N];
    rk4(p, mode, x, u, t, y, 0);
    return guard(p, mode, y);
}

static double locate(const Slip *p, int mode, const double *x, const double *u, double low, double high, double g_low,
                     double g_high)
{
    int last = 0, k;
    for (k = 0; k < 100; k++) {
        double t = high - g_high * (high - low) / (g_high - g_low), g;
        if (!(low < t && t < high)) t = 0.5 * (low + high);
        g = guard_after(p, mode, x, u, t);
        if (fabs(g) <= LOCATED || high - low <= LOCATED) return t;
        if (g > 0.0) {
            low = t, g_low = g;
            if (last == 1) g_high *= 0.5;
            last = 1;
        } else {
            high = t, g_high = g;
            if (last == -1) g_low *= 0.5;
            last = -1;
        }
    }
    return high;
}

static double event(const Slip *p, int mode, const double *x, const double *u, double h, const double *y)
{
    double low = 0.0, g_low = guard(p, mode, x), r = rate(p, mode, x, u), high = h, g_high = guard(p, mode, y);
    int on_guard = g_low <= ON_GUARD, k;
    if (on_guard && r <= 0.0) return -1.0;
    if (g_high >= 0.0) {
        double turned;
        if (r >= 0.0) return -1.0;
        turned = rate(p, mode, y, u);
        if (turned <= 0.0) return -1.0;
        high = h * r / (r - turned);
        g_high = guard_after(p, mode, x, u, high);
        if (g_high >= 0.0) return -1.0;
    }
    if (on_guard) {
        double t = high;
        g_low = -1.0;
        for (k = 0; k < 100; k++) {
            t *= 0.5;
            g_low = guard_after(p, mode, x, u, t);
            if (g_low > 0.0) {
                low = t;
                break;
            }
            high = t, g_high = g_low;
        }
        if (g_low <= 0.0) return -1.0;
    }
    return g_high == 0.0 ? high : locate(p, mode, x, u, low, high, g_low, g_high);
}

static int begin(const Slip *p, int before, const double *x, const double *u)
{
    int now = x[2] <= p->fall ? FALLEN : before;
    if (guard(p, now, x) <= ON_GUARD && rate(p, now, x, u) <= 0.0) return now == FLIGHT ? STANCE : FLIGHT;
    return now;
}

static int forward(const Slip *p, int mode, double *x, const double *u, double h, int step)
{
    double y[N], left = h;
    int s, i;
    mode = begin(p, mode, x, u);
    for (s = 0; s <= EVENTS; s++) {
        Segment *here = &segments[step][s];
        double t;
        counts[step] = s + 1;
        here->mode = mode, here->t = left;
        for (i = 0; i < N; i++) here->x[i] = x[i];
        rk4(p, mode, x, u, left, y, here->d);
        t = s < EVENTS ? event(p, mode, x, u, left, y) : -1.0;
        if (t < 0.0) break;
        here->t = t;
        rk4(p, mode, here->x, u, t, x, here->d);
        mode = mode == FLIGHT ? STANCE : FLIGHT;
        left -= t;
    }
    for (i = 0; i < N; i++) x[i] = y[i];
    return mode;
}

/* w^T dPhi/dx, w^T dPhi/du of a segment; where wanted also w^T dPhi/dh. */
static void segment_back(const Slip *p, const Segment *s, const double *u, const double *w, double h, double *wx,
                         double *wu, double *wh)
{
    double x1[N], x2[N], x3[N], x4[N], v[N], u1[M], u2[M], u3[M], u4[M];
    int i;
    for (i = 0; i < N; i++) v[i] = h / 6.0 * w[i];
    back(s->mode, s->d[3], v, x4, u4);
    for (i = 0; i < N; i++) v[i] = h / 3.0 * w[i] + h * x4[i];
    back(s->mode, s->d[2], v, x3, u3);
    for (i = 0; i < N; i++) v[i] = h / 3.0 * w[i] + 0.5 * h * x3[i];
    back(s->mode, s->d[1], v, x2, u2);
    for (i = 0; i < N; i++) v[i] = h / 6.0 * w[i] + 0.5 * h * x2[i];
    back(s->mode, s->d[0], v, x1, u1);
    if (wh) {
        double k1[N], k2[N], k3[N], k4[N], y[N], sum = 0.0;
        stage(p, s->mode, s->x, u, k1, 0);
        for (i = 0; i < N; i++) y[i] = s->x[i] + 0.5 * h * k1[i];
        stage(p, s->mode, y, u, k2, 0);
        for (i = 0; i < N; i++) y[i] = s->x[i] + 0.5 * h * k2[i];
        stage(p, s->mode, y, u, k3, 0);
        for (i = 0; i < N; i++) y[i] = s->x[i] + h * k3[i];
        stage(p, s->mode, y, u, k4, 0);
        for (i = 0; i < N; i++)
            sum += w[i] * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]) / 6.0 + 0.5 * x2[i] * k1[i]
                   + 0.5 * x3[i] * k2[i] + x4[i] * k3[i];
        *wh = sum;
    }
    for (i = 0; i < N; i++) wx[i] = w[i] + x1[i] + x2[i] + x3[i] + x4[i];
    for (i = 0; i < M; i++) wu[i] = u1[i] + u2[i] + u3[i] + u4[i];
}

static void step_back(const Slip *p, int step, const double *u, double *w, double h, double *wu)
{
    int last = counts[step] - 1, s, i;
    double sigma, x[N], wx[N];
    if (last == 0) {
        segment_back(p, &segments[step][0], u, w, h, wx, wu, 0);
        for (i = 0; i < N; i++) w[i] = wx[i];
        return;
    }
    segment_back(p, &segments[step][last], u, w, segments[step][last].t, wx, wu, &sigma);
    for (i = 0; i < N; i++) w[i] = wx[i], x[i] = segments[step][last].x[i];
    for (s = last - 1; s >= 0; s--) {
        const Segment *here = &segments[step][s];
        double n[N], du[M], dt, nx[N], nu[M], nt, jump;
        guard_gradient(p, here->mode, x, n);
        for (i = 0; i < N; i++) x[i] = here->x[i];
        segment_back(p, here, u, w, here->t, wx, du, &dt);
        segment_back(p, here, u, n, here->t, nx, nu, &nt);
        jump = (sigma - dt) / fmin(nt, -GRAZING);
        for (i = 0; i < N; i++) w[i] = wx[i] + jump * nx[i];
        for (i = 0; i < M; i++) wu[i] += du[i] + jump * nu[i];
    }
}

double criterion(const double *physics, const double *q, const double *target, const double *start, const double *user,
                 double h, int steps)
{
    Slip p = {physics[0], physics[1], physics[2], physics[3], physics[4]};
    double none[M] = {0.0, 0.0}, x[N], rho[N], wu[M];
    int i, k, mode;
    for (i = 0; i < N; i++) x[i] = start[i];
    mode = x[2] <= p.fall ? FALLEN : sqrt((x[0] - x[4]) * (x[0] - x[4]) + x[2] * x[2]) < p.rest ? STANCE : FLIGHT;
    for (k = 0; k < steps; k++) {
        for (i = 0; i < N; i++) nodes[k][i] = x[i];
        mode = forward(&p, mode, x, k == 0 ? user : none, h, k);
    }
    for (i = 0; i < N; i++) rho[i] = 0.5 * h * q[i] * (x[i] - target[i]);
    for (k = steps - 1; k >= 0; k--) {
        step_back(&p, k, k == 0 ? user : none, rho, h, wu);
        for (i = 0; i < N; i++) rho[i] += h * q[i] * (nodes[k][i] - target[i]);
    }
    return wu[0] * user[0] + wu[1] * user[1];
}
