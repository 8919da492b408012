/* How late a bare clock_nanosleep loop wakes: wake PERIOD_NS COUNT prints the lateness of each wake [ns]. */
#define _POSIX_C_SOURCE 200112L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

int main(int argc, char **argv)
{
    long long period = atoll(argv[1]), count = atoll(argv[2]), due, k;
    long long *late = malloc(count * sizeof *late);
    struct timespec t;
    (void)argc;
    clock_gettime(CLOCK_MONOTONIC, &t);
    due = t.tv_sec * 1000000000LL + t.tv_nsec;
    for (k = 0; k < count; k++) {
        due += period;
        t.tv_sec = due / 1000000000LL;
        t.tv_nsec = due % 1000000000LL;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL);
        clock_gettime(CLOCK_MONOTONIC, &t);
        late[k] = t.tv_sec * 1000000000LL + t.tv_nsec - due;
    }
    for (k = 0; k < count; k++) printf("%lld\n", late[k]);
    return 0;
}
