"""One filter evaluation with numba beside a hand-written C version of the same arithmetic, compiled here.

Runs of the two alternate, so that both see the same load; medians and their ratio are what counts. Usage:
``python bench/filter.py [--horizon 1.5] [--runs 60] [--calls 200]``. Needs a C compiler (``$CC``, else cc or gcc).
"""

from __future__ import annotations

import argparse
import ctypes
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from shared_control import controllers, tasks
from shared_control.cost import quadratic
from shared_control.filter import FilterConfig, MigFilter
from shared_control.mig import Criterion
from shared_control.tasks.task import SAMPLE_TIME

C_SOURCE = r"""
#include <math.h>
#include <time.h>

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

double criterion(const double *physics, const double *q, const double *start, double user, double h, int steps)
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
    for (i = 0; i < N; i++) rho[i] = 0.5 * h * q[i] * (i == 0 ? wrap(x[0]) : x[i]);
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
            for (i = 0; i < N; i++) rho[i] += h * q[i] * (i == 0 ? wrap(nodes[t][0]) : nodes[t][i]);
    }
    return rho_u * user;
}
"""


def compile_c(folder: Path) -> ctypes.CDLL:
    """The C version as a library.

    Raises
    ------
    SystemExit: no compiler.
    """
    compiler = os.environ.get("CC") or shutil.which("cc") or shutil.which("gcc")
    if not compiler:
        raise SystemExit("no C compiler found: install gcc or set CC")
    source, library = folder / "criterion.c", folder / "criterion.so"
    source.write_text(C_SOURCE)
    subprocess.run([compiler, "-O3", "-march=native", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    loaded = ctypes.CDLL(str(library))
    loaded.criterion.restype = ctypes.c_double
    return loaded


def seconds(call: Callable[[], object], calls: int) -> float:
    """Mean seconds of a call."""
    begin = time.perf_counter()
    for _ in range(calls):
        call()
    return (time.perf_counter() - begin) / calls


def main() -> int:
    """Measure and print."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--horizon", type=float, default=FilterConfig().horizon)
    arguments.add_argument("--runs", type=int, default=60)
    arguments.add_argument("--calls", type=int, default=200)
    options = arguments.parse_args()

    task = tasks.get("cart_pendulum")
    cost = quadratic(task)
    evaluate = Criterion(task, cost, horizon=options.horizon, dt=SAMPLE_TIME)
    x, good, bad = np.array([1.0, 0.2, 0.3, 0.4]), np.array([-3.0]), np.array([3.0])
    if evaluate(x, good) > 0.0:
        good, bad = bad, good
    filter_ = MigFilter(task, FilterConfig(horizon=options.horizon))
    filter_.warm_up()
    controller = controllers.make("ilqr", task, cost, horizon=options.horizon)

    with tempfile.TemporaryDirectory() as folder:
        library = compile_c(Path(folder))
        double_p = ctypes.POINTER(ctypes.c_double)
        # Kept in names: the library gets addresses, which must outlive the calls.
        physics, weights = np.array(task.parameters[:4]), np.array(cost.state_weights)
        arguments_c = [a.ctypes.data_as(double_p) for a in (physics, weights, x)]
        steps = round(options.horizon / SAMPLE_TIME)
        arguments_c += [ctypes.c_double(good[0]), ctypes.c_double(SAMPLE_TIME), steps]
        c_value, numba_value = library.criterion(*arguments_c), evaluate(x, good)
        if abs(c_value - numba_value) > 1e-9 * abs(c_value):
            raise SystemExit(f"the two versions disagree: {c_value!r} in C, {numba_value!r} with numba")

        def replace() -> None:
            controller.solve(x)
            controller.advance()

        measured: dict[str, tuple[Callable[[], object], list[float]]] = {
            "criterion, C -O3 (called from Python)": (lambda: library.criterion(*arguments_c), []),
            "criterion, numba (called from Python)": (lambda: evaluate(x, good), []),
            "filter decision, accepted": (lambda: filter_.decide(x, good), []),
            "filter decision, replaced (iLQR, warm)": (lambda: filter_.decide(x, bad), []),
            "controller iLQR alone, warm": (replace, []),
        }
        for _ in range(options.runs):
            for call, times in measured.values():
                times.append(seconds(call, options.calls))

    base = statistics.median(next(iter(measured.values()))[1])
    print(f"cart-pendulum, horizon {options.horizon} s = {steps} steps; {options.runs} runs of {options.calls}")
    print(f"{'':42}{'p50 us':>10}{'least us':>10}{'x C':>8}")
    for title, (_, times) in measured.items():
        middle = statistics.median(times)
        print(f"{title:42}{1e6 * middle:10.1f}{1e6 * min(times):10.1f}{middle / base:8.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
