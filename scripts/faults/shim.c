/* Makes one call of the C library fail, for files below one folder: loaded with LD_PRELOAD by scripts/faults.py.
 *
 * FAULT_DIR    the folder (an absolute path without links)
 * FAULT_CALL   open, read, write, fsync, rename, link, mkdir or unlink
 * FAULT_AT     which call of these in the process, from 1; 0 counts calls only
 * FAULT_KIND   eio, enospc, eacces, short (half of a write), or power: the process ends, and bytes that were not synced are lost
 * FAULT_COUNT  a file that gets the number of calls at the end of the process (optional)
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <signal.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

#define MOST_FILES 4096

/* A file below the folder that was opened for writing: its path and the bytes that are safe. */
struct file {
    char path[PATH_MAX];
    off_t synced;
    int fd;
};

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static struct file *files[MOST_FILES];
static int known, calls, below_folder[65536];
static const char *folder, *call, *kind;
static int at;
static pid_t owner;

static void *next(const char *name) { return dlsym(RTLD_NEXT, name); }

__attribute__((constructor)) static void begin(void) {
    folder = getenv("FAULT_DIR");
    call = getenv("FAULT_CALL");
    kind = getenv("FAULT_KIND");
    at = getenv("FAULT_AT") ? atoi(getenv("FAULT_AT")) : 0;
    owner = getpid();
}

__attribute__((destructor)) static void end(void) {
    const char *count = getenv("FAULT_COUNT");
    if (!count || getpid() != owner)
        return;
    FILE *out = fopen(count, "w");
    if (out) {
        fprintf(out, "%d\n", calls);
        fclose(out);
    }
}

static int is_below(const char *path) {
    if (!folder || !path)
        return 0;
    char full[PATH_MAX], resolved[PATH_MAX];
    if (path[0] != '/') {
        if (!getcwd(full, sizeof full) || strlen(full) + strlen(path) + 2 > sizeof full)
            return 0;
        strcat(strcat(full, "/"), path);
        path = full;
    }
    /* A new file has no resolved path, but its folder has one. */
    snprintf(resolved, sizeof resolved, "%s", path);
    size_t n = strlen(folder);
    return strncmp(resolved, folder, n) == 0 && (resolved[n] == '/' || resolved[n] == 0);
}

/* Loses what was not synced, and ends the process as a power failure does. */
static void lose(void) {
    int (*real_truncate)(const char *, off_t) = next("truncate");
    for (int i = 0; i < known; i++) {
        struct stat now;
        if (stat(files[i]->path, &now) == 0 && S_ISREG(now.st_mode) && now.st_size > files[i]->synced)
            (void)!real_truncate(files[i]->path, files[i]->synced);
    }
    kill(getpid(), SIGKILL);
}

/* Counts a call. Gives the error of the call, 0 without one, or -1 for half of a write. */
static int fault(const char *name) {
    if (!call || strcmp(call, name) != 0 || getpid() != owner)
        return 0;
    pthread_mutex_lock(&lock);
    int now = ++calls;
    pthread_mutex_unlock(&lock);
    if (at == 0 || now != at)
        return 0;
    if (!strcmp(kind, "power"))
        lose();
    if (!strcmp(kind, "enospc"))
        return ENOSPC;
    if (!strcmp(kind, "eacces"))
        return EACCES;
    return strcmp(kind, "short") ? EIO : -1;
}

static void opened(int fd, const char *path, int flags) {
    if (fd < 0 || fd >= 65536)
        return;
    below_folder[fd] = 1;
    if ((flags & O_ACCMODE) == O_RDONLY)
        return;
    pthread_mutex_lock(&lock);
    char full[PATH_MAX];
    struct stat now;
    if (realpath(path, full) && fstat(fd, &now) == 0) {
        int i = 0;
        while (i < known && strcmp(files[i]->path, full))
            i++;
        if (i == known && known < MOST_FILES) {
            files[known] = calloc(1, sizeof(struct file));
            snprintf(files[known]->path, PATH_MAX, "%s", full);
            files[known++]->synced = now.st_size;
        }
        if (i < known) {
            files[i]->fd = fd;
            if (flags & O_TRUNC)
                files[i]->synced = 0;
        }
    }
    pthread_mutex_unlock(&lock);
}

static void synced(int fd) {
    struct stat now;
    pthread_mutex_lock(&lock);
    for (int i = 0; i < known; i++)
        if (files[i]->fd == fd && fstat(fd, &now) == 0)
            files[i]->synced = now.st_size;
    pthread_mutex_unlock(&lock);
}

static void renamed(const char *from, const char *to) {
    char full[PATH_MAX];
    if (!realpath(to, full))
        return;
    pthread_mutex_lock(&lock);
    /* The old file of this name is gone. */
    for (int i = 0; i < known; i++)
        if (!strcmp(files[i]->path, full))
            files[i]->path[0] = 0;
    for (int i = 0; i < known; i++) {
        const char *name = strrchr(files[i]->path, '/'), *old = strrchr(from, '/');
        if (name && !strcmp(name + 1, old ? old + 1 : from))
            snprintf(files[i]->path, PATH_MAX, "%s", full);
    }
    pthread_mutex_unlock(&lock);
}

#define FAIL(error) do { errno = (error); return -1; } while (0)

static int open_any(const char *symbol, int dir, const char *path, int flags, mode_t mode) {
    int relevant = path && (path[0] == '/' || dir == AT_FDCWD) && is_below(path);
    int error = relevant ? fault("open") : 0;
    if (error > 0)
        FAIL(error);
    int fd;
    if (dir == AT_FDCWD && strncmp(symbol, "openat", 6))
        fd = ((int (*)(const char *, int, mode_t))next(symbol))(path, flags, mode);
    else
        fd = ((int (*)(int, const char *, int, mode_t))next(symbol))(dir, path, flags, mode);
    if (relevant)
        opened(fd, path, flags);
    else if (fd >= 0 && fd < 65536)
        below_folder[fd] = 0;
    return fd;
}

#define MODE(flags) \
    mode_t mode = 0; \
    if ((flags) & (O_CREAT | O_TMPFILE)) { va_list rest; va_start(rest, flags); mode = va_arg(rest, mode_t); va_end(rest); }

int open(const char *path, int flags, ...) { MODE(flags) return open_any("open", AT_FDCWD, path, flags, mode); }
int open64(const char *path, int flags, ...) { MODE(flags) return open_any("open64", AT_FDCWD, path, flags, mode); }
int openat(int dir, const char *path, int flags, ...) { MODE(flags) return open_any("openat", dir, path, flags, mode); }
int openat64(int dir, const char *path, int flags, ...) { MODE(flags) return open_any("openat64", dir, path, flags, mode); }

#define RELEVANT(fd) ((fd) >= 0 && (fd) < 65536 && below_folder[fd])

ssize_t write(int fd, const void *bytes, size_t n) {
    int error = RELEVANT(fd) ? fault("write") : 0;
    if (error > 0)
        FAIL(error);
    return ((ssize_t(*)(int, const void *, size_t))next("write"))(fd, bytes, error < 0 ? (n + 1) / 2 : n);
}

ssize_t writev(int fd, const struct iovec *parts, int n) {
    int error = RELEVANT(fd) ? fault("write") : 0;
    if (error > 0)
        FAIL(error);
    return ((ssize_t(*)(int, const struct iovec *, int))next("writev"))(fd, parts, error < 0 ? 1 : n);
}

ssize_t pwrite64(int fd, const void *bytes, size_t n, off64_t place) {
    int error = RELEVANT(fd) ? fault("write") : 0;
    if (error > 0)
        FAIL(error);
    return ((ssize_t(*)(int, const void *, size_t, off64_t))next("pwrite64"))(fd, bytes, error < 0 ? (n + 1) / 2 : n, place);
}

ssize_t read(int fd, void *bytes, size_t n) {
    int error = RELEVANT(fd) ? fault("read") : 0;
    if (error > 0)
        FAIL(error);
    return ((ssize_t(*)(int, void *, size_t))next("read"))(fd, bytes, error < 0 ? (n + 1) / 2 : n);
}

ssize_t pread64(int fd, void *bytes, size_t n, off64_t place) {
    int error = RELEVANT(fd) ? fault("read") : 0;
    if (error > 0)
        FAIL(error);
    return ((ssize_t(*)(int, void *, size_t, off64_t))next("pread64"))(fd, bytes, n, place);
}

static int sync_any(const char *symbol, int fd) {
    int error = RELEVANT(fd) ? fault("fsync") : 0;
    if (error > 0)
        FAIL(error);
    int done = ((int (*)(int))next(symbol))(fd);
    if (done == 0)
        synced(fd);
    return done;
}

int fsync(int fd) { return sync_any("fsync", fd); }
int fdatasync(int fd) { return sync_any("fdatasync", fd); }

int rename(const char *from, const char *to) {
    int error = is_below(to) ? fault("rename") : 0;
    if (error > 0)
        FAIL(error);
    int done = ((int (*)(const char *, const char *))next("rename"))(from, to);
    if (done == 0 && is_below(to))
        renamed(from, to);
    return done;
}

int link(const char *from, const char *to) {
    int error = is_below(to) ? fault("link") : 0;
    if (error > 0)
        FAIL(error);
    return ((int (*)(const char *, const char *))next("link"))(from, to);
}

int linkat(int a, const char *from, int b, const char *to, int flags) {
    int error = is_below(to) ? fault("link") : 0;
    if (error > 0)
        FAIL(error);
    return ((int (*)(int, const char *, int, const char *, int))next("linkat"))(a, from, b, to, flags);
}

int mkdir(const char *path, mode_t mode) {
    int error = is_below(path) ? fault("mkdir") : 0;
    if (error > 0)
        FAIL(error);
    return ((int (*)(const char *, mode_t))next("mkdir"))(path, mode);
}

int unlink(const char *path) {
    int error = is_below(path) ? fault("unlink") : 0;
    if (error > 0)
        FAIL(error);
    return ((int (*)(const char *))next("unlink"))(path);
}
