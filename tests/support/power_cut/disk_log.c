/* Logs every change that a process makes to the files below a folder, for the power-cut model.
 *
 * Loaded with LD_PRELOAD. DISK_ROOT is the folder, DISK_LOG the file that takes the log. A record
 * is a header and its bytes (see disk.py): what happened, the number of the open file, an offset,
 * a size. A lock around each call and its record makes the log the order of the changes; syncs
 * are logged when they begin and when they end. Shared mappings (SQLite's -shm) are not logged:
 * they do not survive a power cut. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/sendfile.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

enum { OPEN = 1, WRITE, TRUNCATE, SYNC, SYNCED, RENAME, UNLINK, MKDIR, RMDIR, LINK, UNKNOWN };

struct record {
  uint32_t what, handle;
  uint64_t offset, size;
};

#define MAX_FD 4096
static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static char root[PATH_MAX];
static size_t root_size;
static int log_fd = -1;
static uint32_t handles, handle_of[MAX_FD];
static ino_t inode_of[MAX_FD];

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

__attribute__((constructor)) static void attach(void) {
  const char *folder = getenv("DISK_ROOT"), *path = getenv("DISK_LOG");
  if (!folder || !path || !realpath(folder, root)) return;
  root_size = strlen(root);
  log_fd = REAL(open)(path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
}

static void note(uint32_t what, uint32_t handle, uint64_t offset, const void *data, size_t size) {
  struct record record = {what, handle, offset, size};
  struct iovec parts[2] = {{&record, sizeof record}, {(void *)data, size}};
  ssize_t wanted = (ssize_t)(sizeof record + size);
  if (REAL(writev)(log_fd, parts, 2) != wanted) abort(); /* a log with holes proves nothing */
}

/* Return the path below the root, or NULL; `full` holds PATH_MAX bytes. */
static const char *below(int folder, const char *path, char *full) {
  char parent[PATH_MAX], *name;
  if (log_fd < 0 || !path) return NULL;
  if (path[0] == '/' || folder == AT_FDCWD) {
    snprintf(parent, sizeof parent, "%s", path);
  } else {
    char link[64];
    snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
    ssize_t size = readlink(link, full, PATH_MAX - 1);
    if (size < 0) return NULL;
    snprintf(parent, sizeof parent, "%.*s/%s", (int)size, full, path);
  }
  name = strrchr(parent, '/');
  if (name) *name++ = 0;
  char *real = realpath(name ? (parent[0] ? parent : "/") : ".", full);
  if (!real) return NULL;
  size_t size = strlen(full);
  snprintf(full + size, PATH_MAX - size, "/%s", name ? name : parent);
  if (strncmp(full, root, root_size)) return NULL;
  if (!full[root_size]) return full + root_size; /* the root itself */
  return full[root_size] == '/' ? full + root_size + 1 : NULL;
}

static uint32_t handle(int fd) {
  struct stat facts;
  if (fd < 0 || fd >= MAX_FD || !handle_of[fd] || fstat(fd, &facts)) return 0;
  return facts.st_ino == inode_of[fd] ? handle_of[fd] : 0;
}

static void opened(int fd, const char *path, int flags) {
  struct stat facts;
  if (fd < 0 || fd >= MAX_FD || fstat(fd, &facts)) return;
  handle_of[fd] = 0;
  if (!path || !(S_ISREG(facts.st_mode) || S_ISDIR(facts.st_mode))) return;
  handle_of[fd] = ++handles;
  inode_of[fd] = facts.st_ino;
  note(OPEN, handles, S_ISDIR(facts.st_mode) ? 2 : (flags & O_TRUNC) != 0, path, strlen(path));
}

static int opening(int folder, const char *path, int flags, mode_t mode) {
  int (*real)(int, const char *, int, ...) = dlsym(RTLD_NEXT, "openat64");
  char full[PATH_MAX];
  pthread_mutex_lock(&lock);
  const char *inside = (flags & O_TMPFILE) != O_TMPFILE ? below(folder, path, full) : NULL;
  char kept[PATH_MAX];
  if (inside) snprintf(kept, sizeof kept, "%s", inside);
  int fd = real(folder, path, flags, mode), error = errno;
  opened(fd, inside ? kept : NULL, flags);
  pthread_mutex_unlock(&lock);
  errno = error;
  return fd;
}

#define MODE(flags)                               \
  mode_t mode = 0;                                \
  if (((flags) & O_CREAT) || ((flags) & O_TMPFILE) == O_TMPFILE) {        \
    va_list more;                                 \
    va_start(more, flags);                        \
    mode = va_arg(more, mode_t);                  \
    va_end(more);                                 \
  }

int open(const char *path, int flags, ...) {
  MODE(flags)
  return opening(AT_FDCWD, path, flags, mode);
}
int open64(const char *path, int flags, ...) {
  MODE(flags)
  return opening(AT_FDCWD, path, flags, mode);
}
int openat(int folder, const char *path, int flags, ...) {
  MODE(flags)
  return opening(folder, path, flags, mode);
}
int openat64(int folder, const char *path, int flags, ...) {
  MODE(flags)
  return opening(folder, path, flags, mode);
}

int close(int fd) {
  pthread_mutex_lock(&lock);
  if (fd >= 0 && fd < MAX_FD && fd != log_fd) handle_of[fd] = 0;
  pthread_mutex_unlock(&lock);
  return REAL(close)(fd);
}

ssize_t write(int fd, const void *data, size_t size) {
  if (fd < 0 || fd >= MAX_FD || !handle_of[fd]) return REAL(write)(fd, data, size);
  pthread_mutex_lock(&lock);
  ssize_t done = REAL(write)(fd, data, size);
  int error = errno;
  uint32_t number = handle(fd);
  if (done > 0 && number)
    note(WRITE, number, (uint64_t)(lseek(fd, 0, SEEK_CUR) - done), data, (size_t)done);
  pthread_mutex_unlock(&lock);
  errno = error;
  return done;
}

ssize_t writev(int fd, const struct iovec *parts, int count) {
  if (fd < 0 || fd >= MAX_FD || !handle_of[fd]) return REAL(writev)(fd, parts, count);
  ssize_t total = 0;
  for (int i = 0; i < count; ++i) { /* as single writes: fewer bytes than asked are allowed */
    ssize_t done = write(fd, parts[i].iov_base, parts[i].iov_len);
    if (done < 0) return total ? total : done;
    total += done;
    if ((size_t)done < parts[i].iov_len) break;
  }
  return total;
}

ssize_t pwrite64(int fd, const void *data, size_t size, off64_t offset) {
  if (fd < 0 || fd >= MAX_FD || !handle_of[fd]) return REAL(pwrite64)(fd, data, size, offset);
  pthread_mutex_lock(&lock);
  ssize_t done = REAL(pwrite64)(fd, data, size, offset);
  int error = errno;
  uint32_t number = handle(fd);
  if (done > 0 && number) note(WRITE, number, (uint64_t)offset, data, (size_t)done);
  pthread_mutex_unlock(&lock);
  errno = error;
  return done;
}
ssize_t pwrite(int fd, const void *data, size_t size, off_t offset) {
  return pwrite64(fd, data, size, offset);
}

int ftruncate64(int fd, off64_t size) {
  pthread_mutex_lock(&lock);
  int done = REAL(ftruncate64)(fd, size), error = errno;
  uint32_t number = handle(fd);
  if (!done && number) note(TRUNCATE, number, (uint64_t)size, "", 0);
  pthread_mutex_unlock(&lock);
  errno = error;
  return done;
}
int ftruncate(int fd, off_t size) { return ftruncate64(fd, size); }

/* Syncs: what was written before the begin is on the disk at the end. */
static int syncing(const char *symbol, int fd) {
  int (*real)(int) = dlsym(RTLD_NEXT, symbol);
  uint32_t number = 0;
  pthread_mutex_lock(&lock);
  number = handle(fd);
  if (number) note(SYNC, number, 0, "", 0);
  pthread_mutex_unlock(&lock);
  int done = real(fd), error = errno;
  pthread_mutex_lock(&lock);
  if (number && !done) note(SYNCED, number, 0, "", 0);
  pthread_mutex_unlock(&lock);
  errno = error;
  return done;
}
int fsync(int fd) { return syncing("fsync", fd); }
int fdatasync(int fd) { return syncing("fdatasync", fd); }

static int naming(uint32_t what, int from_folder, const char *from, int to_folder, const char *to,
                  unsigned flags) {
  char one[PATH_MAX], other[PATH_MAX], both[2 * PATH_MAX];
  pthread_mutex_lock(&lock);
  const char *a = below(from_folder, from, one);
  const char *b = to ? below(to_folder, to, other) : "";
  int done = -1, error;
  switch (what) {
    case RENAME: done = renameat2(from_folder, from, to_folder, to, flags); break;
    case LINK: done = REAL(linkat)(from_folder, from, to_folder, to, (int)flags); break;
    case MKDIR: done = REAL(mkdirat)(from_folder, from, flags); break;
    default: done = REAL(unlinkat)(from_folder, from, (int)flags); break;
  }
  error = errno;
  if (!done && a && b) {
    int size = snprintf(both, sizeof both, "%s%c%s", a, 0, b);
    note(what, 0, strlen(a), both, (size_t)size);
  } else if (!done && (a || (to && b))) {
    note(UNKNOWN, 0, 0, "a name crossed the border of the folder", 39);
  }
  pthread_mutex_unlock(&lock);
  errno = error;
  return done;
}

int rename(const char *from, const char *to) {
  return naming(RENAME, AT_FDCWD, from, AT_FDCWD, to, 0);
}
int renameat(int folder, const char *from, int other, const char *to) {
  return naming(RENAME, folder, from, other, to, 0);
}
int link(const char *from, const char *to) {
  return naming(LINK, AT_FDCWD, from, AT_FDCWD, to, 0);
}
int linkat(int folder, const char *from, int other, const char *to, int flags) {
  return naming(LINK, folder, from, other, to, (unsigned)flags);
}
int unlink(const char *path) { return naming(UNLINK, AT_FDCWD, path, 0, NULL, 0); }
int unlinkat(int folder, const char *path, int flags) {
  return naming(flags & AT_REMOVEDIR ? RMDIR : UNLINK, folder, path, 0, NULL, (unsigned)flags);
}
int rmdir(const char *path) { return naming(RMDIR, AT_FDCWD, path, 0, NULL, AT_REMOVEDIR); }
int mkdir(const char *path, mode_t mode) {
  return naming(MKDIR, AT_FDCWD, path, 0, NULL, mode);
}
int mkdirat(int folder, const char *path, mode_t mode) {
  return naming(MKDIR, folder, path, 0, NULL, mode);
}

/* Calls that nothing here uses so far: a log that misses them would prove nothing. */
ssize_t sendfile64(int to, int from, off64_t *offset, size_t size) {
  if (to >= 0 && to < MAX_FD && handle(to)) {
    errno = EINVAL; /* shutil copies by read and write then */
    return -1;
  }
  return REAL(sendfile64)(to, from, offset, size);
}
ssize_t sendfile(int to, int from, off_t *offset, size_t size) {
  return sendfile64(to, from, offset, size);
}
ssize_t copy_file_range(int from, off64_t *at, int to, off64_t *where, size_t size, unsigned flags) {
  if (to >= 0 && to < MAX_FD && handle(to)) {
    errno = EXDEV;
    return -1;
  }
  return REAL(copy_file_range)(from, at, to, where, size, flags);
}
int posix_fallocate64(int fd, off64_t offset, off64_t size) {
  return fd >= 0 && fd < MAX_FD && handle(fd) ? EOPNOTSUPP
                                              : REAL(posix_fallocate64)(fd, offset, size);
}
int posix_fallocate(int fd, off_t offset, off_t size) { return posix_fallocate64(fd, offset, size); }
int fallocate64(int fd, int mode, off64_t offset, off64_t size) {
  if (fd >= 0 && fd < MAX_FD && handle(fd)) {
    errno = EOPNOTSUPP;
    return -1;
  }
  return REAL(fallocate64)(fd, mode, offset, size);
}
