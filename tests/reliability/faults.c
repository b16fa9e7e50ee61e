/* A disk that fails: preloaded into a process, it makes the Nth change of a file below a folder fail.

   FAULT_ROOT names the folder, FAULT_CONTROL a file of four 64-bit numbers that is shared by all processes:
   how many changes there were, which one is to fail, how (see below), how many have failed. Where half of one
   is to be written, only writes count. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <unistd.h>

enum { FULL = 1, BROKEN = 2, SHORT = 3 }; /* ENOSPC from then on; EIO once; half of it once */
enum { PASS = 0, HALVE = -1 };            /* else an errno */

struct control { int64_t n_changes, failing, how, n_failed; };
static struct control *control;
static const char *root;

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

__attribute__((constructor)) static void start(void) {
  const char *path = getenv("FAULT_CONTROL");
  root = getenv("FAULT_ROOT");
  if (!path || !root) return;
  int file = REAL(open)(path, O_RDWR);
  if (file < 0) return;
  void *shared = mmap(NULL, sizeof *control, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
  if (shared != MAP_FAILED) control = shared;
  close(file);
}

static int fate_of(const char *path, int is_write) {
  if (!control || strncmp(path, root, strlen(root)) != 0) return PASS;
  if (control->how == SHORT && !is_write) return PASS;
  int64_t number = __atomic_add_fetch(&control->n_changes, 1, __ATOMIC_SEQ_CST);
  int is_due = control->how == FULL ? number >= control->failing : number == control->failing;
  if (control->failing <= 0 || !is_due) return PASS;
  __atomic_add_fetch(&control->n_failed, 1, __ATOMIC_SEQ_CST);
  return control->how == FULL ? ENOSPC : control->how == BROKEN ? EIO : HALVE;
}

static int fate_of_file(int file, int is_write) {
  char link[64], path[PATH_MAX];
  snprintf(link, sizeof link, "/proc/self/fd/%d", file);
  ssize_t length = readlink(link, path, sizeof path - 1);
  if (length < 0) return PASS;
  path[length] = 0;
  return fate_of(path, is_write);
}

#define FAIL_OR_HALVE(fate, size)                            \
  if (fate > 0) { errno = fate; return -1; }                 \
  if (fate == HALVE && size > 1) size /= 2;
#define FAIL(fate) if (fate > 0) { errno = fate; return -1; }

ssize_t write(int file, const void *bytes, size_t size) {
  int fate = fate_of_file(file, 1);
  FAIL_OR_HALVE(fate, size)
  return REAL(write)(file, bytes, size);
}
ssize_t pwrite(int file, const void *bytes, size_t size, off_t offset) {
  int fate = fate_of_file(file, 1);
  FAIL_OR_HALVE(fate, size)
  return REAL(pwrite)(file, bytes, size, offset);
}
ssize_t pwrite64(int file, const void *bytes, size_t size, off64_t offset) {
  int fate = fate_of_file(file, 1);
  FAIL_OR_HALVE(fate, size)
  return REAL(pwrite64)(file, bytes, size, offset);
}
ssize_t copy_file_range(int from, off64_t *in, int to, off64_t *out, size_t size, unsigned flags) {
  int fate = fate_of_file(to, 1);
  FAIL_OR_HALVE(fate, size)
  return REAL(copy_file_range)(from, in, to, out, size, flags);
}
ssize_t sendfile(int to, int from, off_t *offset, size_t size);
ssize_t sendfile(int to, int from, off_t *offset, size_t size) {
  int fate = fate_of_file(to, 1);
  FAIL_OR_HALVE(fate, size)
  return REAL(sendfile)(to, from, offset, size);
}
ssize_t sendfile64(int to, int from, off64_t *offset, size_t size);
ssize_t sendfile64(int to, int from, off64_t *offset, size_t size) {
  int fate = fate_of_file(to, 1);
  FAIL_OR_HALVE(fate, size)
  return REAL(sendfile64)(to, from, offset, size);
}
int fsync(int file) {
  int fate = fate_of_file(file, 0);
  FAIL(fate)
  return REAL(fsync)(file);
}
int fdatasync(int file) {
  int fate = fate_of_file(file, 0);
  FAIL(fate)
  return REAL(fdatasync)(file);
}
int ftruncate(int file, off_t size) {
  int fate = fate_of_file(file, 0);
  FAIL(fate)
  return REAL(ftruncate)(file, size);
}
int ftruncate64(int file, off64_t size) {
  int fate = fate_of_file(file, 0);
  FAIL(fate)
  return REAL(ftruncate64)(file, size);
}
int mkdir(const char *path, mode_t mode) {
  int fate = fate_of(path, 0);
  FAIL(fate)
  return REAL(mkdir)(path, mode);
}
int rename(const char *from, const char *to) {
  int fate = fate_of(to, 0);
  FAIL(fate)
  return REAL(rename)(from, to);
}
int renameat2(int a, const char *from, int b, const char *to, unsigned flags) {
  int fate = fate_of(to, 0);
  FAIL(fate)
  return REAL(renameat2)(a, from, b, to, flags);
}

#define OPEN(name)                                                      \
  int name(const char *path, int flags, ...) {                          \
    mode_t mode = 0;                                                    \
    if ((flags & O_CREAT) || (flags & O_TMPFILE) == O_TMPFILE) {        \
      va_list rest;                                                     \
      va_start(rest, flags);                                            \
      mode = va_arg(rest, mode_t);                                      \
      va_end(rest);                                                     \
    }                                                                   \
    if (flags & O_CREAT) {                                              \
      int fate = fate_of(path, 0);                                      \
      FAIL(fate)                                                        \
    }                                                                   \
    return REAL(name)(path, flags, mode);                               \
  }
OPEN(open)
OPEN(open64)
