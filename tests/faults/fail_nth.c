/* SPDX-License-Identifier: GPL-3.0-or-later
 *
 * Preloaded (LD_PRELOAD), fails the n-th call of one kind, as a full disk, a lost network or a lack of memory would.
 *
 * Files: by the environment. FAIL_FOLDER: only what lies below it counts, so that Blender's own files are left alone.
 * FAIL_CALL: write, fsync, rename, open (for writing) or read. FAIL_NTH: which of them, from 1. FAIL_ERRNO: with which
 * error. FAIL_ONCE: the later ones succeed again. FAIL_COUNTER: a file of five numbers, in which the calls of each kind
 * are counted, those of child processes too. A process that has changed its environment calls fail_files().
 *
 * Memory: fail_malloc(n) fails the n-th allocation that the engine's module makes from then on, 0 none, and returns how
 * many it has made since the last call. Those of Python, NumPy and Blender do not count.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <link.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/uio.h>
#include <unistd.h>

/* Files ---------------------------------------------------------------------------------------------------------- */

enum { WRITE, FSYNC, RENAME, OPEN, READ, KINDS };
static const char* const names[KINDS] = {"write", "fsync", "rename", "open", "read"};

static const char *folder, *kind;
static long nth;
static int code, once;
static atomic_long* counters; /* of each kind; NULL: nothing counts and nothing fails */

__attribute__((constructor)) void fail_files(void) {
  folder = getenv("FAIL_FOLDER");
  kind = getenv("FAIL_CALL");
  const char *n = getenv("FAIL_NTH"), *error = getenv("FAIL_ERRNO"), *file = getenv("FAIL_COUNTER");
  nth = n ? atol(n) : 0;
  code = error ? atoi(error) : EIO;
  once = getenv("FAIL_ONCE") != NULL;
  if (counters) munmap(counters, KINDS * sizeof *counters);
  counters = NULL;
  const int fd = folder && kind && file ? open(file, O_RDWR | O_CLOEXEC) : -1;
  if (fd < 0) return;
  void* shared = mmap(NULL, KINDS * sizeof *counters, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  if (shared != MAP_FAILED) counters = shared;
  close(fd);
}

/* Whether this call is to fail, on that path. */
static int fails(int call, const char* path) {
  if (strncmp(path, folder, strlen(folder))) return 0;
  const long count = atomic_fetch_add(&counters[call], 1) + 1;
  if (strcmp(names[call], kind) || !nth || (once ? count != nth : count < nth)) return 0;
  errno = code;
  return 1;
}

static int fails_fd(int call, int fd) {
  char link[64], path[4096];
  if (!counters) return 0;
  const int before = errno;
  snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  const ssize_t length = readlink(link, path, sizeof path - 1);
  errno = before;
  if (length < 0) return 0;
  path[length] = 0;
  return fails(call, path);
}

/* A path relative to the working directory is below the folder where that is. */
static int fails_at(int call, const char* path) {
  char whole[8192], here[4096];
  if (!counters) return 0;
  if (path[0] == '/') return fails(call, path);
  if (!getcwd(here, sizeof here)) return 0;
  snprintf(whole, sizeof whole, "%s/%s", here, path);
  return fails(call, whole);
}

#define NEXT(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

#define ON_FD(call, type, name, parameters, ...) \
  type name parameters {                         \
    if (fails_fd(call, fd)) return -1;           \
    return NEXT(name)(__VA_ARGS__);              \
  }

ON_FD(WRITE, ssize_t, write, (int fd, const void* bytes, size_t size), fd, bytes, size)
ON_FD(WRITE, ssize_t, pwrite, (int fd, const void* bytes, size_t size, off_t at), fd, bytes, size, at)
ON_FD(WRITE, ssize_t, pwrite64, (int fd, const void* bytes, size_t size, off64_t at), fd, bytes, size, at)
ON_FD(WRITE, ssize_t, writev, (int fd, const struct iovec* parts, int count), fd, parts, count)
ON_FD(READ, ssize_t, read, (int fd, void* bytes, size_t size), fd, bytes, size)
ON_FD(FSYNC, int, fsync, (int fd), fd)
ON_FD(FSYNC, int, fdatasync, (int fd), fd)

size_t fwrite(const void* bytes, size_t size, size_t count, FILE* file) {
  if (fails_fd(WRITE, fileno(file))) return 0;
  return NEXT(fwrite)(bytes, size, count, file);
}

int rename(const char* from, const char* to) { return fails_at(RENAME, to) ? -1 : NEXT(rename)(from, to); }

/* Of os.rename and os.replace. */
int renameat(int from_folder, const char* from, int to_folder, const char* to) {
  return fails_at(RENAME, to) ? -1 : NEXT(renameat)(from_folder, from, to_folder, to);
}

#define OPENS(name)                                                         \
  int name(const char* path, int flags, ...) {                              \
    va_list more;                                                           \
    va_start(more, flags);                                                  \
    const int mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(more, int) : 0; \
    va_end(more);                                                           \
    if ((flags & O_ACCMODE) != O_RDONLY && fails_at(OPEN, path)) return -1; \
    return NEXT(name)(path, flags, mode);                                   \
  }

OPENS(open)
OPENS(open64)

#define FOPENS(name)                                                               \
  FILE* name(const char* path, const char* mode) {                                 \
    return mode[0] != 'r' && fails_at(OPEN, path) ? NULL : NEXT(name)(path, mode); \
  }

FOPENS(fopen)
FOPENS(fopen64)

/* Memory --------------------------------------------------------------------------------------------------------- */

extern void *__libc_malloc(size_t), *__libc_calloc(size_t, size_t), *__libc_realloc(void*, size_t),
    *__libc_memalign(size_t, size_t);

static char *module_begin, *module_end; /* where the engine's code is */
static atomic_long allocations, failing;

static int find_module(struct dl_phdr_info* info, size_t size, void* data) {
  (void)size, (void)data;
  if (!strstr(info->dlpi_name, "/_core.")) return 0;
  for (int i = 0; i < info->dlpi_phnum; ++i) {
    const ElfW(Phdr)* part = &info->dlpi_phdr[i];
    if (part->p_type != PT_LOAD || !(part->p_flags & PF_X)) continue;
    module_begin = (char*)info->dlpi_addr + part->p_vaddr;
    module_end = module_begin + part->p_memsz;
  }
  return 1;
}

long fail_malloc(long n) {
  atomic_store(&failing, n);
  if (!module_begin) dl_iterate_phdr(find_module, NULL);
  return atomic_exchange(&allocations, 0);
}

static int out_of_memory(void* caller) {
  if ((char*)caller < module_begin || (char*)caller >= module_end) return 0;
  if (atomic_fetch_add(&allocations, 1) + 1 != atomic_load(&failing)) return 0;
  errno = ENOMEM;
  return 1;
}

#define FROM_HERE out_of_memory(__builtin_return_address(0))

void* malloc(size_t size) { return FROM_HERE ? NULL : __libc_malloc(size); }
void* calloc(size_t count, size_t size) { return FROM_HERE ? NULL : __libc_calloc(count, size); }
void* realloc(void* old, size_t size) { return FROM_HERE ? NULL : __libc_realloc(old, size); }
void* aligned_alloc(size_t alignment, size_t size) { return FROM_HERE ? NULL : __libc_memalign(alignment, size); }
