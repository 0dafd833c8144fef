/* Makes one call of the C library fail, for files below one folder, or logs all calls that change it: loaded with LD_PRELOAD by
 * scripts/faults/faults.py.
 *
 * FAULT_DIR    the folder (an absolute path without links)
 * FAULT_CALL   open (to read), create (to write), read, write, truncate, fsync, rename, link, mkdir or unlink
 * FAULT_AT     which call of these in the process, from 1
 * FAULT_KIND   eio, enospc, eacces, short (half of a read or write), or full: half of this write, and no space for any later one
 * FAULT_HIT    a file that gets the path of the call that failed
 * FAULT_COUNT  a file that gets the number of calls of each name at the end of the process
 * FAULT_LOG    a file that gets every call that changes the folder, in order (read by scripts/faults/disk.py)
 *
 * Programs that this one starts are left alone.
 */
#define _GNU_SOURCE
#include <dirent.h>
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
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

enum { OPEN, CREATE, READ, WRITE, TRUNCATE, FSYNC, RENAME, LINK, MKDIR, UNLINK, CALLS };
static const char *const NAMES[CALLS] = {"open", "create", "read", "write", "truncate", "fsync", "rename", "link", "mkdir", "unlink"};

#define MOST_DESCRIPTORS 65536
/* The largest write that is logged in one record. */
#define MOST_BYTES (64 << 20)

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static const char *folder, *kind, *hit, *count;
static int wanted = -1, at, full, calls[CALLS], log_fd = -1;
static uint32_t handles;
/* For each descriptor of a file below the folder: its handle in the log, and its path. */
static uint32_t handle_of[MOST_DESCRIPTORS];
static char *path_of[MOST_DESCRIPTORS];

#define REAL(type, name, ...) ((type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, name))

static int raw_open(const char *path) { return (int)syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0600); }

__attribute__((constructor)) static void begin(void) {
    const char *call = getenv("FAULT_CALL"), *log = getenv("FAULT_LOG");
    folder = getenv("FAULT_DIR");
    kind = getenv("FAULT_KIND") ? getenv("FAULT_KIND") : "";
    hit = getenv("FAULT_HIT");
    count = getenv("FAULT_COUNT");
    at = getenv("FAULT_AT") ? atoi(getenv("FAULT_AT")) : 0;
    for (int i = 0; call && i < CALLS; i++)
        if (!strcmp(NAMES[i], call))
            wanted = i;
    if (log)
        log_fd = raw_open(log);
    unsetenv("LD_PRELOAD");
}

__attribute__((destructor)) static void end(void) {
    int fd = count ? raw_open(count) : -1;
    for (int i = 0; fd >= 0 && i < CALLS; i++) {
        char line[64];
        int n = snprintf(line, sizeof line, "%s %d\n", NAMES[i], calls[i]);
        syscall(SYS_write, fd, line, n);
    }
}

/* The path without `.` and `..`, if it is below the folder. Links are not followed: the folder has none. */
static int below(int dir, const char *path, char *out) {
    char whole[2 * PATH_MAX];
    if (!folder || !path)
        return 0;
    if (path[0] == '/') {
        snprintf(whole, sizeof whole, "%s", path);
    } else {
        char base[PATH_MAX], link[64];
        if (dir == AT_FDCWD) {
            if (!getcwd(base, sizeof base))
                return 0;
        } else {
            snprintf(link, sizeof link, "/proc/self/fd/%d", dir);
            ssize_t n = readlink(link, base, sizeof base - 1);
            if (n < 0)
                return 0;
            base[n] = 0;
        }
        snprintf(whole, sizeof whole, "%s/%s", base, path);
    }
    size_t length = 0;
    out[0] = 0;
    for (char *rest = whole, *part; (part = strsep(&rest, "/"));) {
        if (!*part || !strcmp(part, "."))
            continue;
        if (!strcmp(part, "..")) {
            while (length && out[--length] != '/')
                ;
            out[length] = 0;
        } else if (length + strlen(part) + 2 < PATH_MAX) {
            length += (size_t)sprintf(out + length, "/%s", part);
        }
    }
    size_t n = strlen(folder);
    return strncmp(out, folder, n) == 0 && (out[n] == '/' || out[n] == 0);
}

/* Counts a call. Gives its error, 0 without one, or -1 for half of a read or write. Called with the lock. */
static int fault(int call, const char *path) {
    calls[call]++;
    if (full && (call == CREATE || call == WRITE || call == MKDIR))
        return ENOSPC;
    if (call != wanted || calls[call] != at)
        return 0;
    int fd = hit ? raw_open(hit) : -1;
    if (fd >= 0) {
        syscall(SYS_write, fd, path, strlen(path));
        syscall(SYS_close, fd);
    }
    if (!strcmp(kind, "full")) {
        full = 1;
        return -1;
    }
    if (!strcmp(kind, "enospc"))
        return ENOSPC;
    if (!strcmp(kind, "eacces"))
        return EACCES;
    return strcmp(kind, "short") ? EIO : -1;
}

/* One record: the operation, a handle, a number, and two texts. */
static void record(char operation, uint32_t handle, uint64_t number, const void *a, uint32_t n, const void *b, uint32_t m) {
    if (log_fd < 0)
        return;
    char head[1 + 4 + 8 + 4 + 4];
    head[0] = operation;
    memcpy(head + 1, &handle, 4);
    memcpy(head + 5, &number, 8);
    memcpy(head + 13, &n, 4);
    memcpy(head + 17, &m, 4);
    struct iovec parts[3] = {{head, sizeof head}, {(void *)a, n}, {(void *)b, m}};
    syscall(SYS_writev, log_fd, parts, 3);
}

static void record_paths(char operation, const char *a, const char *b) {
    record(operation, 0, 0, a, (uint32_t)strlen(a), b, (uint32_t)strlen(b));
}

/* The path of a descriptor below the folder, or null. */
static const char *known(int fd) { return fd >= 0 && fd < MOST_DESCRIPTORS && handle_of[fd] ? path_of[fd] : NULL; }

#define LOCKED pthread_mutex_lock(&lock)
#define UNLOCK pthread_mutex_unlock(&lock)
#define FAIL(error) do { UNLOCK; errno = (error); return -1; } while (0)

static int open_any(const char *symbol, int dir, const char *path, int flags, mode_t mode) {
    char whole[PATH_MAX];
    int relevant = below(dir, path, whole);
    int writes = (flags & O_ACCMODE) != O_RDONLY || (flags & O_CREAT);
    LOCKED;
    int error = relevant ? fault(writes ? CREATE : OPEN, whole) : 0;
    if (error > 0)
        FAIL(error);
    int fd = strncmp(symbol, "openat", 6) ? REAL(int, symbol, const char *, int, mode_t)(path, flags, mode)
                                          : REAL(int, symbol, int, const char *, int, mode_t)(dir, path, flags, mode);
    if (fd >= 0 && fd < MOST_DESCRIPTORS) {
        handle_of[fd] = 0;
        if (relevant) {
            handle_of[fd] = ++handles;
            free(path_of[fd]);
            path_of[fd] = strdup(whole);
            struct stat now;
            uint32_t rights = REAL(int, "fstat", int, struct stat *)(fd, &now) == 0 ? now.st_mode & 07777 : 0644;
            record('O', handles, (uint64_t)flags, whole, (uint32_t)strlen(whole), &rights, sizeof rights);
        }
    }
    UNLOCK;
    return fd;
}

#define MODE(flags) \
    mode_t mode = 0; \
    if ((flags) & (O_CREAT | O_TMPFILE)) { va_list rest; va_start(rest, flags); mode = va_arg(rest, mode_t); va_end(rest); }

int open(const char *path, int flags, ...) { MODE(flags) return open_any("open", AT_FDCWD, path, flags, mode); }
int open64(const char *path, int flags, ...) { MODE(flags) return open_any("open64", AT_FDCWD, path, flags, mode); }
int openat(int dir, const char *path, int flags, ...) { MODE(flags) return open_any("openat", dir, path, flags, mode); }
int openat64(int dir, const char *path, int flags, ...) { MODE(flags) return open_any("openat64", dir, path, flags, mode); }

DIR *opendir(const char *path) {
    char whole[PATH_MAX];
    LOCKED;
    int error = below(AT_FDCWD, path, whole) ? fault(OPEN, whole) : 0;
    UNLOCK;
    if (error > 0) {
        errno = error;
        return NULL;
    }
    return REAL(DIR *, "opendir", const char *)(path);
}

int close(int fd) {
    LOCKED;
    if (fd >= 0 && fd < MOST_DESCRIPTORS)
        handle_of[fd] = 0;
    UNLOCK;
    return REAL(int, "close", int)(fd);
}

/* A second descriptor of the same file. */
static int duplicate(int fd, int copy) {
    LOCKED;
    if (copy >= 0 && copy < MOST_DESCRIPTORS) {
        handle_of[copy] = known(fd) ? handle_of[fd] : 0;
        free(path_of[copy]);
        path_of[copy] = known(fd) ? strdup(path_of[fd]) : NULL;
    }
    UNLOCK;
    return copy;
}

static int fcntl_any(const char *symbol, int fd, int command, void *argument) {
    int done = REAL(int, symbol, int, int, ...)(fd, command, argument);
    return command == F_DUPFD || command == F_DUPFD_CLOEXEC ? duplicate(fd, done) : done;
}

#define ARGUMENT(command) va_list rest; va_start(rest, command); void *argument = va_arg(rest, void *); va_end(rest)

int fcntl(int fd, int command, ...) { ARGUMENT(command); return fcntl_any("fcntl", fd, command, argument); }
int fcntl64(int fd, int command, ...) { ARGUMENT(command); return fcntl_any("fcntl64", fd, command, argument); }
int dup(int fd) { return duplicate(fd, REAL(int, "dup", int)(fd)); }

/* Writes bytes at a place, or at the position of the descriptor if the place is negative. */
static ssize_t write_any(int fd, const void *bytes, size_t n, off64_t place) {
    LOCKED;
    const char *path = known(fd);
    int error = path ? fault(WRITE, path) : 0;
    if (error > 0)
        FAIL(error);
    if (error < 0)
        n = (n + 1) / 2;
    if (path && n > MOST_BYTES)
        n = MOST_BYTES;
    ssize_t done = place < 0 ? REAL(ssize_t, "write", int, const void *, size_t)(fd, bytes, n)
                             : REAL(ssize_t, "pwrite64", int, const void *, size_t, off64_t)(fd, bytes, n, place);
    if (path && done > 0) {
        off64_t from = place < 0 ? lseek64(fd, 0, SEEK_CUR) - done : place;
        record('W', handle_of[fd], (uint64_t)from, bytes, (uint32_t)done, NULL, 0);
    }
    UNLOCK;
    return done;
}

ssize_t write(int fd, const void *bytes, size_t n) { return write_any(fd, bytes, n, -1); }
ssize_t pwrite64(int fd, const void *bytes, size_t n, off64_t place) { return write_any(fd, bytes, n, place); }
ssize_t pwrite(int fd, const void *bytes, size_t n, off_t place) { return write_any(fd, bytes, n, place); }

ssize_t writev(int fd, const struct iovec *parts, int n) {
    /* A short write is one that the kernel may do, too. */
    if (known(fd))
        return n > 0 ? write_any(fd, parts[0].iov_base, parts[0].iov_len, -1) : 0;
    return REAL(ssize_t, "writev", int, const struct iovec *, int)(fd, parts, n);
}

static ssize_t read_any(int fd, void *bytes, size_t n, off64_t place) {
    LOCKED;
    const char *path = known(fd);
    int error = path ? fault(READ, path) : 0;
    if (error > 0)
        FAIL(error);
    UNLOCK;
    if (error < 0)
        n = (n + 1) / 2;
    return place < 0 ? REAL(ssize_t, "read", int, void *, size_t)(fd, bytes, n)
                     : REAL(ssize_t, "pread64", int, void *, size_t, off64_t)(fd, bytes, n, place);
}

ssize_t read(int fd, void *bytes, size_t n) { return read_any(fd, bytes, n, -1); }
ssize_t pread64(int fd, void *bytes, size_t n, off64_t place) { return read_any(fd, bytes, n, place); }
ssize_t pread(int fd, void *bytes, size_t n, off_t place) { return read_any(fd, bytes, n, place); }

/* The caller then reads and writes, which is logged. */
ssize_t copy_file_range(int from, off64_t *a, int to, off64_t *b, size_t n, unsigned flags) {
    if (known(from) || known(to)) {
        errno = ENOSYS;
        return -1;
    }
    return REAL(ssize_t, "copy_file_range", int, off64_t *, int, off64_t *, size_t, unsigned)(from, a, to, b, n, flags);
}

ssize_t sendfile64(int to, int from, off64_t *place, size_t n) {
    if (known(from) || known(to)) {
        errno = ENOSYS;
        return -1;
    }
    return REAL(ssize_t, "sendfile64", int, int, off64_t *, size_t)(to, from, place, n);
}

static int truncate_any(const char *symbol, int fd, off64_t size) {
    LOCKED;
    const char *path = known(fd);
    int error = path ? fault(TRUNCATE, path) : 0;
    if (error > 0)
        FAIL(error);
    int done = REAL(int, symbol, int, off64_t)(fd, size);
    if (path && done == 0)
        record('T', handle_of[fd], (uint64_t)size, NULL, 0, NULL, 0);
    UNLOCK;
    return done;
}

int ftruncate(int fd, off_t size) { return truncate_any("ftruncate", fd, size); }
int ftruncate64(int fd, off64_t size) { return truncate_any("ftruncate64", fd, size); }

static int sync_any(const char *symbol, int fd) {
    LOCKED;
    const char *path = known(fd);
    int error = path ? fault(FSYNC, path) : 0;
    if (error > 0)
        FAIL(error);
    int done = REAL(int, symbol, int)(fd);
    if (path && done == 0)
        record('F', handle_of[fd], 0, NULL, 0, NULL, 0);
    UNLOCK;
    return done;
}

int fsync(int fd) { return sync_any("fsync", fd); }
int fdatasync(int fd) { return sync_any("fdatasync", fd); }

/* A call that changes entries of folders: two paths, of which the second one is the new name, or one. */
#define ENTRY(call, operation, dir_a, a, dir_b, b, done) \
    char first[PATH_MAX], second[PATH_MAX]; \
    int relevant = below(dir_a, a, first) && below(dir_b, b, second); \
    LOCKED; \
    int error = relevant ? fault(call, second) : 0; \
    if (error > 0) FAIL(error); \
    int result = done; \
    if (relevant && result == 0) record_paths(operation, first, second); \
    UNLOCK; \
    return result
#define ENTRY_OF_ONE(call, operation, dir, path, done) ENTRY(call, operation, dir, path, dir, path, done)

int renameat(int from_dir, const char *from, int to_dir, const char *to) {
    ENTRY(RENAME, 'R', from_dir, from, to_dir, to, REAL(int, "renameat", int, const char *, int, const char *)(from_dir, from, to_dir, to));
}

int rename(const char *from, const char *to) { return renameat(AT_FDCWD, from, AT_FDCWD, to); }

int renameat2(int from_dir, const char *from, int to_dir, const char *to, unsigned flags) {
    ENTRY(RENAME, 'R', from_dir, from, to_dir, to, (int)syscall(SYS_renameat2, from_dir, from, to_dir, to, flags));
}

int linkat(int from_dir, const char *from, int to_dir, const char *to, int flags) {
    ENTRY(LINK, 'L', from_dir, from, to_dir, to, REAL(int, "linkat", int, const char *, int, const char *, int)(from_dir, from, to_dir, to, flags));
}

int link(const char *from, const char *to) { return linkat(AT_FDCWD, from, AT_FDCWD, to, 0); }

int mkdirat(int dir, const char *path, mode_t mode) {
    ENTRY_OF_ONE(MKDIR, 'M', dir, path, REAL(int, "mkdirat", int, const char *, mode_t)(dir, path, mode));
}

int mkdir(const char *path, mode_t mode) { return mkdirat(AT_FDCWD, path, mode); }

int unlinkat(int dir, const char *path, int flags) {
    ENTRY_OF_ONE(UNLINK, 'U', dir, path, REAL(int, "unlinkat", int, const char *, int)(dir, path, flags));
}

int unlink(const char *path) { return unlinkat(AT_FDCWD, path, 0); }
int rmdir(const char *path) { return unlinkat(AT_FDCWD, path, AT_REMOVEDIR); }
