/* How late a bare clock_nanosleep loop wakes: wake PERIOD_NS COUNT [PRIORITY] prints its SCHED_FIFO priority (0: ordinary
   scheduling), the steady time of its begin [ns], then the lateness of each wake [ns], of COUNT or until SIGTERM. A
   priority that is refused is said, and the loop runs without it. */
#define _POSIX_C_SOURCE 200112L
#include <errno.h>
#include <sched.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static volatile sig_atomic_t told_to_end;

static void end(int number)
{
    (void)number;
    told_to_end = 1;
}

int main(int argc, char **argv)
{
    long long period = atoll(argv[1]), count = atoll(argv[2]), begin, due, k;
    long long *late = malloc(count * sizeof *late);
    struct timespec t;
    struct sched_param fifo = {.sched_priority = argc > 3 ? atoi(argv[3]) : 0};
    if (argc > 3 && sched_setscheduler(0, SCHED_FIFO, &fifo) != 0) {
        fprintf(stderr, "no SCHED_FIFO %d: %s\n", fifo.sched_priority, strerror(errno));
        fifo.sched_priority = 0;
    }
    signal(SIGTERM, end);
    clock_gettime(CLOCK_MONOTONIC, &t);
    due = begin = t.tv_sec * 1000000000LL + t.tv_nsec;
    for (k = 0; k < count && !told_to_end; k++) {
        due += period;
        t.tv_sec = due / 1000000000LL;
        t.tv_nsec = due % 1000000000LL;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
        clock_gettime(CLOCK_MONOTONIC, &t);
        late[k] = t.tv_sec * 1000000000LL + t.tv_nsec - due;
    }
    count = k;
    printf("%d\n%lld\n", fifo.sched_priority, begin);
    for (k = 0; k < count; k++) printf("%lld\n", late[k]);
    return 0;
}
