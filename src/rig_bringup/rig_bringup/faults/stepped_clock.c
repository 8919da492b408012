/* Steps the wall clock of one process, as settimeofday would for all: for `./rig faults`, loaded with LD_PRELOAD.
 *
 * The file that RIG_CLOCK_STEP names holds the step, a 64-bit number of nanoseconds, and may change at any moment.
 * Waits until a time of the wall clock end when that clock shows it: a step forward cuts them short, a step back makes
 * them longer. The steady clock is left alone.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdatomic.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

#define SECOND 1000000000LL
#define SLICE (20 * SECOND / 1000) /* how often a wait looks whether the clock was stepped */

static const volatile int64_t none = 0, *step = &none;
static int (*gettime)(clockid_t, struct timespec *);
static int (*cond_wait)(pthread_cond_t *, pthread_mutex_t *, const struct timespec *);
static int (*cond_signal)(pthread_cond_t *), (*cond_broadcast)(pthread_cond_t *);
static int (*sem_wait_until)(sem_t *, const struct timespec *);

/* How often conditions were signalled, those together that share a place. */
static atomic_uint signals[4096];

static void *next(const char *name, const char *version)
{
    void *found = version ? dlvsym(RTLD_NEXT, name, version) : NULL;
    return found ? found : dlsym(RTLD_NEXT, name);
}

__attribute__((constructor)) static void begin(void)
{
    const char *path = getenv("RIG_CLOCK_STEP");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    gettime = next("clock_gettime", NULL);
    cond_wait = next("pthread_cond_timedwait", "GLIBC_2.3.2");
    cond_signal = next("pthread_cond_signal", "GLIBC_2.3.2");
    cond_broadcast = next("pthread_cond_broadcast", "GLIBC_2.3.2");
    sem_wait_until = next("sem_timedwait", NULL);
    if (file >= 0) {
        void *mapped = mmap(NULL, sizeof *step, PROT_READ, MAP_SHARED, file, 0);
        if (mapped != MAP_FAILED)
            step = mapped;
        close(file);
    }
}

static int64_t count(const struct timespec *t) { return t->tv_sec * SECOND + t->tv_nsec; }

static struct timespec spec(int64_t t) { return (struct timespec){t / SECOND, t % SECOND}; }

int clock_gettime(clockid_t clock, struct timespec *now)
{
    if (!gettime)
        begin(); /* another library's constructor asks before ours has run */
    int failed = gettime(clock, now);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        *now = spec(count(now) + *step);
    return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
    struct timespec t;
    (void)zone;
    clock_gettime(CLOCK_REALTIME, &t);
    now->tv_sec = t.tv_sec, now->tv_usec = t.tv_nsec / 1000;
    return 0;
}

time_t time(time_t *result)
{
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    return result ? (*result = t.tv_sec) : t.tv_sec;
}

/* The end of the next slice on the real clock; 0 if the stepped clock has come to `until`. */
static int slice(const struct timespec *until, struct timespec *end)
{
    struct timespec now;
    gettime(CLOCK_REALTIME, &now);
    int64_t left = count(until) - count(&now) - *step;
    *end = spec(count(&now) + (left < SLICE ? left : SLICE));
    return left > 0;
}

/* Seconds since 1970 and since the machine was started are far apart: which clock a condition waits on shows in these. */
static int of_wall_clock(const struct timespec *until) { return until->tv_sec > 1000000000; }

static atomic_uint *signals_of(const pthread_cond_t *cond) { return &signals[((uintptr_t)cond >> 4) % 4096]; }

int pthread_cond_signal(pthread_cond_t *cond)
{
    if (!cond_signal)
        begin();
    atomic_fetch_add(signals_of(cond), 1);
    return cond_signal(cond);
}

int pthread_cond_broadcast(pthread_cond_t *cond)
{
    if (!cond_broadcast)
        begin();
    atomic_fetch_add(signals_of(cond), 1);
    return cond_broadcast(cond);
}

int pthread_cond_timedwait(pthread_cond_t *cond, pthread_mutex_t *mutex, const struct timespec *until)
{
    struct timespec end;
    unsigned seen = atomic_load(signals_of(cond));

    if (!of_wall_clock(until))
        return cond_wait(cond, mutex, until);
    /* A signal that comes between two slices finds nobody who waits: then the caller is to look at its condition. */
    do {
        if (!slice(until, &end))
            return ETIMEDOUT;
        int result = cond_wait(cond, mutex, &end);
        if (result != ETIMEDOUT)
            return result;
    } while (atomic_load(signals_of(cond)) == seen);
    return 0;
}

int sem_timedwait(sem_t *sem, const struct timespec *until)
{
    struct timespec end;
    while (slice(until, &end)) {
        int result = sem_wait_until(sem, &end);
        if (result == 0 || errno != ETIMEDOUT)
            return result;
    }
    if (sem_trywait(sem) == 0)
        return 0;
    errno = ETIMEDOUT;
    return -1;
}
