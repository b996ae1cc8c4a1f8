/* What a test does to a process that it cannot do to the machine: another time of day, and a disk
 * without room. Loaded with LD_PRELOAD; the file named by CHAOS_CONTROL states what holds now:
 * int64 nanoseconds added to CLOCK_REALTIME, then int64, not 0 when regular files take no bytes. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <sys/uio.h>
#include <time.h>
#include <unistd.h>

static const volatile int64_t *control;

__attribute__((constructor)) static void attach(void) {
    const char *path = getenv("CHAOS_CONTROL");
    int number = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (number < 0) return;
    void *mapped = mmap(NULL, 16, PROT_READ, MAP_SHARED, number, 0);
    if (mapped != MAP_FAILED) control = mapped;
    close(number);
}

static int is_full(int number) {
    struct stat facts;
    return control && control[1] && fstat(number, &facts) == 0 && S_ISREG(facts.st_mode);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))
#define REFUSE_IF_FULL(number)    \
    do {                          \
        if (is_full(number)) {    \
            errno = ENOSPC;       \
            return -1;            \
        }                         \
    } while (0)

ssize_t write(int number, const void *data, size_t size) {
    static __typeof__(&write) real;
    if (!real) real = REAL(write);
    REFUSE_IF_FULL(number);
    return real(number, data, size);
}

ssize_t pwrite(int number, const void *data, size_t size, off_t offset) {
    static __typeof__(&pwrite) real;
    if (!real) real = REAL(pwrite);
    REFUSE_IF_FULL(number);
    return real(number, data, size, offset);
}

ssize_t pwrite64(int number, const void *data, size_t size, off64_t offset) {
    static __typeof__(&pwrite64) real;
    if (!real) real = REAL(pwrite64);
    REFUSE_IF_FULL(number);
    return real(number, data, size, offset);
}

ssize_t writev(int number, const struct iovec *parts, int count) {
    static __typeof__(&writev) real;
    if (!real) real = REAL(writev);
    REFUSE_IF_FULL(number);
    return real(number, parts, count);
}

int clock_gettime(clockid_t which, struct timespec *now) {
    static __typeof__(&clock_gettime) real;
    if (!real) real = REAL(clock_gettime);
    int result = real(which, now);
    if (result == 0 && control && which == CLOCK_REALTIME) {
        int64_t total = (int64_t)now->tv_sec * 1000000000 + now->tv_nsec + control[0];
        now->tv_sec = total / 1000000000;
        now->tv_nsec = total % 1000000000;
    }
    return result;
}
