/* Injects one fault into the file operations below a folder. Loaded with LD_PRELOAD by tests/crash.rs.
 *
 * FAULT_DIR   folder whose operations count
 * FAULT_AT    number of the operation that fails, from 1; 0 for none
 * FAULT_KIND  kill: the process dies before the operation; eio, enospc: it fails; short: a write stores half of its bytes
 * FAULT_COUNT file that receives the number of operations when the process ends
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

static atomic_long operations;

static int is_inside(const char *path) {
    const char *folder = getenv("FAULT_DIR");
    size_t length = folder ? strlen(folder) : 0;
    return length > 0 && strncmp(path, folder, length) == 0;
}

static int is_inside_fd(int fd) {
    char link[64], path[PATH_MAX];
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t length = readlink(link, path, sizeof path - 1);
    if (length < 0) {
        return 0;
    }
    path[length] = 0;
    return is_inside(path);
}

/* 0: carry on; 1: fail with errno; 2: write half. */
static int fault(void) {
    const char *at = getenv("FAULT_AT"), *kind = getenv("FAULT_KIND");
    long number = atomic_fetch_add(&operations, 1) + 1;
    if (!at || !kind || number != atol(at)) {
        return 0;
    }
    if (strcmp(kind, "kill") == 0) {
        kill(getpid(), SIGKILL);
        pause();
    }
    if (strcmp(kind, "short") == 0) {
        return 2;
    }
    errno = strcmp(kind, "enospc") == 0 ? ENOSPC : EIO;
    return 1;
}

__attribute__((destructor)) static void report(void) {
    const char *path = getenv("FAULT_COUNT");
    if (!path) {
        return;
    }
    char text[32];
    int length = snprintf(text, sizeof text, "%ld", atomic_load(&operations));
    int fd = (int)syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_TRUNC, 0600);
    syscall(SYS_write, fd, text, length);
    syscall(SYS_close, fd);
}

ssize_t write(int fd, const void *bytes, size_t length) {
    switch (is_inside_fd(fd) ? fault() : 0) {
    case 1:
        return -1;
    case 2:
        return syscall(SYS_write, fd, bytes, length / 2 + 1 < length ? length / 2 + 1 : length);
    }
    return syscall(SYS_write, fd, bytes, length);
}

ssize_t writev(int fd, const struct iovec *parts, int count) {
    switch (is_inside_fd(fd) ? fault() : 0) {
    case 1:
        return -1;
    case 2:
        return syscall(SYS_writev, fd, parts, 1);
    }
    return syscall(SYS_writev, fd, parts, count);
}

ssize_t copy_file_range(int from, off_t *a, int to, off_t *b, size_t length, unsigned flags) {
    return is_inside_fd(to) && fault() == 1 ? -1 : syscall(SYS_copy_file_range, from, a, to, b, length, flags);
}

#define WRAP(condition, call) return (condition) && fault() == 1 ? -1 : (int)(call)

int fsync(int fd) { WRAP(is_inside_fd(fd), syscall(SYS_fsync, fd)); }
int fdatasync(int fd) { WRAP(is_inside_fd(fd), syscall(SYS_fdatasync, fd)); }
int ftruncate64(int fd, off64_t length) { WRAP(is_inside_fd(fd), syscall(SYS_ftruncate, fd, length)); }
int ftruncate(int fd, off_t length) { WRAP(is_inside_fd(fd), syscall(SYS_ftruncate, fd, length)); }
int unlink(const char *path) { WRAP(is_inside(path), syscall(SYS_unlinkat, AT_FDCWD, path, 0)); }
int rename(const char *from, const char *to) {
    WRAP(is_inside(to), syscall(SYS_renameat2, AT_FDCWD, from, AT_FDCWD, to, 0));
}
int link(const char *from, const char *to) {
    WRAP(is_inside(to), syscall(SYS_linkat, AT_FDCWD, from, AT_FDCWD, to, 0));
}
int linkat(int a, const char *from, int b, const char *to, int flags) {
    WRAP(is_inside(to), syscall(SYS_linkat, a, from, b, to, flags));
}
int mkdir(const char *path, mode_t mode) { WRAP(is_inside(path), syscall(SYS_mkdirat, AT_FDCWD, path, mode)); }
