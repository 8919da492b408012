/* The criterion of the cart-pendulum along the nominal trajectory: what shared_control.mig computes, by hand. */
#include <math.h>
#include <string.h>

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

/* g/h, 1/h, B/(m h^2) */
typedef struct { double pull, lever, friction; } Pendulum;

static void stage(const Pendulum *p, const double *x, double u, double *f, double *d)
{
    double s = sin(x[0]), c = cos(x[0]), push = u * p->lever;
    f[0] = x[1];
    f[1] = p->pull * s - push * c - p->friction * x[1];
    f[2] = x[3];
    f[3] = u;
    d[0] = p->pull * c + push * s;
    d[1] = -c * p->lever;
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
    Pendulum p = {physics[2] / physics[3], 1.0 / physics[3], physics[1] / (physics[0] * physics[3] * physics[3])};
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

/* The replacement: shared_control.controllers.ilqr_kernels for this task, one input, by hand. */

typedef struct { Pendulum p; const double *q, *terminal, *target; double r, h; int steps; } Problem;

static void errors(const Problem *m, const double *x, double *e)
{
    e[0] = wrap(x[0] - m->target[0]);
    for (int i = 1; i < N; i++) e[i] = x[i] - m->target[i];
}

static double weighted(const Problem *m, const double *weights, const double *x)
{
    double e[N], sum = 0.0;
    errors(m, x, e);
    for (int i = 0; i < N; i++) sum += weights[i] * e[i] * e[i];
    return 0.5 * sum;
}

static void flow(const Pendulum *p, const double *x, double u, double *f)
{
    f[0] = x[1];
    f[1] = p->pull * sin(x[0]) - u * p->lever * cos(x[0]) - p->friction * x[1];
    f[2] = x[3];
    f[3] = u;
}

static void step(const Problem *m, double *x, double u)
{
    double k[4][N], y[N], h = m->h;
    int i;
    flow(&m->p, x, u, k[0]);
    for (i = 0; i < N; i++) y[i] = x[i] + 0.5 * h * k[0][i];
    flow(&m->p, y, u, k[1]);
    for (i = 0; i < N; i++) y[i] = x[i] + 0.5 * h * k[1][i];
    flow(&m->p, y, u, k[2]);
    for (i = 0; i < N; i++) y[i] = x[i] + h * k[2][i];
    flow(&m->p, y, u, k[3]);
    for (i = 0; i < N; i++) x[i] += h / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
}

static double clip(double value, double low, double high) { return fmin(fmax(value, low), high); }

/* J of clip(u + alpha k + K (x_new - x)); of u itself where there are no gains. */
static double rollout(const Problem *m, const double *start, const double *us, double (*xs)[N], const double *ks,
                      double (*gains)[N], double alpha, double limit, double *us_new, double (*xs_new)[N])
{
    double x[N], total = 0.0;
    for (int i = 0; i < N; i++) x[i] = start[i];
    for (int t = 0; t < m->steps; t++) {
        double u = us[t];
        for (int i = 0; i < N; i++) xs_new[t][i] = x[i];
        if (gains) {
            u += alpha * ks[t];
            for (int i = 0; i < N; i++) u += gains[t][i] * (x[i] - xs[t][i]);
            u = clip(u, -limit, limit);
            us_new[t] = u;
        }
        total += m->h * ((t == 0 ? 0.5 : 1.0) * weighted(m, m->q, x) + 0.5 * m->r * u * u);
        step(m, x, u);
    }
    for (int i = 0; i < N; i++) xs_new[m->steps][i] = x[i];
    return total + 0.5 * m->h * weighted(m, m->q, x) + weighted(m, m->terminal, x);
}

/* dPhi/dx (a) and dPhi/du (b), row by row, by pullbacks through the four stages. */
static void jacobians(const Problem *m, const double *x, double u, double (*a)[N], double *b)
{
    double k[N], y[N], d[4][2], h = m->h;
    int i, j;
    stage(&m->p, x, u, k, d[0]);
    for (i = 0; i < N; i++) y[i] = x[i] + 0.5 * h * k[i];
    stage(&m->p, y, u, k, d[1]);
    for (i = 0; i < N; i++) y[i] = x[i] + 0.5 * h * k[i];
    stage(&m->p, y, u, k, d[2]);
    for (i = 0; i < N; i++) y[i] = x[i] + h * k[i];
    stage(&m->p, y, u, k, d[3]);
    for (j = 0; j < N; j++) {
        double w[N], s[4][N], slope, unit[N] = {0.0, 0.0, 0.0, 0.0};
        unit[j] = 1.0;
        for (i = 0; i < N; i++) w[i] = h / 6.0 * unit[i];
        slope = back(&m->p, d[3], w, s[3]);
        for (i = 0; i < N; i++) w[i] = h / 3.0 * unit[i] + h * s[3][i];
        slope += back(&m->p, d[2], w, s[2]);
        for (i = 0; i < N; i++) w[i] = h / 3.0 * unit[i] + 0.5 * h * s[2][i];
        slope += back(&m->p, d[1], w, s[1]);
        for (i = 0; i < N; i++) w[i] = h / 6.0 * unit[i] + 0.5 * h * s[1][i];
        b[j] = slope + back(&m->p, d[0], w, s[0]);
        for (i = 0; i < N; i++) a[j][i] = unit[i] + s[0][i] + s[1][i] + s[2][i] + s[3][i];
    }
}

typedef struct { double linear, quadratic, largest; } Model;

static Model backward(const Problem *m, const double *us, double (*xs)[N], double limit, double damping, double *ks,
                      double (*gains)[N])
{
    Model found = {0.0, 0.0, 0.0};
    double e[N], vx[N], vxx[N][N] = {{0.0}}, h = m->h;
    int i, j, l;
    errors(m, xs[m->steps], e);
    for (i = 0; i < N; i++) {
        vxx[i][i] = 0.5 * h * m->q[i] + m->terminal[i];
        vx[i] = vxx[i][i] * e[i];
    }
    for (int t = m->steps - 1; t >= 0; t--) {
        double a[N][N], b[N], va[N][N], vb[N], qux[N], next[N], qu = h * m->r * us[t], quu = h * m->r;
        jacobians(m, xs[t], us[t], a, b);
        for (i = 0; i < N; i++) {
            vb[i] = 0.0;
            for (l = 0; l < N; l++) vb[i] += vxx[i][l] * b[l];
            for (j = 0; j < N; j++) {
                va[i][j] = 0.0;
                for (l = 0; l < N; l++) va[i][j] += vxx[i][l] * a[l][j];
            }
        }
        for (l = 0; l < N; l++) {
            qu += b[l] * vx[l];
            quu += b[l] * vb[l];
        }
        for (i = 0; i < N; i++) {
            qux[i] = 0.0;
            for (l = 0; l < N; l++) qux[i] += b[l] * va[l][i];
        }
        double damped = quu + damping + 1e-9, low = -limit - us[t], high = limit - us[t], du = clip(0.0, low, high);
        du = clip(du - (qu + damped * du) / damped, low, high);
        double slope = qu + damped * du;
        int at_limit = (du <= low && slope > 0.0) || (du >= high && slope < 0.0);
        ks[t] = du;
        found.largest = fmax(found.largest, fabs(du) / limit);
        for (i = 0; i < N; i++) gains[t][i] = at_limit ? 0.0 : -qux[i] / damped;
        errors(m, xs[t], e);
        found.linear += du * qu;
        found.quadratic += 0.5 * du * quu * du;
        for (i = 0; i < N; i++) {
            next[i] = h * m->q[i] * e[i] + gains[t][i] * (quu * du + qu) + qux[i] * du;
            for (l = 0; l < N; l++) next[i] += a[l][i] * vx[l];
        }
        for (i = 0; i < N; i++) vx[i] = next[i];
        for (i = 0; i < N; i++)
            for (j = 0; j <= i; j++) {
                double total = i == j ? h * m->q[i] : 0.0;
                for (l = 0; l < N; l++) total += a[l][i] * va[l][j];
                total += gains[t][i] * (quu * gains[t][j] + qux[j]) + qux[i] * gains[t][j];
                vxx[i][j] = vxx[j][i] = total;
            }
    }
    return found;
}

static double ours[MAX_STEPS + 1][N], theirs[MAX_STEPS + 1][N], feedback[MAX_STEPS][N];
static double change[MAX_STEPS], tried[MAX_STEPS];

/* Improves the schedule us in place; J of what it is then. */
double replacement(const double *physics, const double *q, const double *target, const double *terminal, double weight,
                   double limit, const double *start, double *us, double h, int steps, int iterations, double tolerance)
{
    Problem m = {{physics[2] / physics[3], 1.0 / physics[3], physics[1] / (physics[0] * physics[3] * physics[3])},
                 q, terminal, target, weight, h, steps};
    double best = rollout(&m, start, us, 0, 0, 0, 0.0, limit, 0, ours), damping = 0.0;
    for (int t = 0; t < steps; t++) tried[t] = 0.0;
    double idle = rollout(&m, start, tried, 0, 0, 0, 0.0, limit, 0, theirs);
    if (!(best <= idle) && isfinite(idle)) {
        best = idle;
        memcpy(us, tried, sizeof(double) * steps);
        memcpy(ours, theirs, sizeof(double) * N * (steps + 1));
    }
    for (int iteration = 0; iteration < iterations; iteration++) {
        Model model = backward(&m, us, ours, limit, damping, change, feedback);
        if (model.largest < tolerance) break;
        double alpha = 1.0, cost = 0.0;
        int improved = 0;
        for (int halving = 0; halving < 6 && !improved; halving++, alpha *= 0.5) {
            double promised = -(alpha * model.linear + alpha * alpha * model.quadratic);
            cost = rollout(&m, start, us, ours, change, feedback, alpha, limit, tried, theirs);
            improved = isfinite(cost) && best - cost > 1e-4 * fmax(promised, 0.0);
        }
        if (improved) {
            double gain = best - cost;
            best = cost;
            memcpy(us, tried, sizeof(double) * steps);
            memcpy(ours, theirs, sizeof(double) * N * (steps + 1));
            damping = damping <= 1e-3 ? 0.0 : damping / 10.0;
            if (gain <= tolerance * fabs(best)) break;
        } else {
            damping = fmax(1e-3, 10.0 * damping);
            if (damping > 1e6) break;
        }
    }
    return best;
}

/* A decision: the schedule of a tick ago moved on by a sample, the criterion of the user's control, and if that is positive
   the search, from the schedule in place. */
double decision(const double *physics, const double *q, const double *target, const double *terminal, double weight,
                double limit, const double *start, const double *user, double *us, double h, int steps, int iterations,
                double tolerance)
{
    memmove(us, us + 1, sizeof(double) * (steps - 1));
    us[steps - 1] = 0.0;
    if (criterion(physics, q, target, start, user, h, steps) <= 0.0) return user[0];
    replacement(physics, q, target, terminal, weight, limit, start, us, h, steps, iterations, tolerance);
    return us[0];
}
