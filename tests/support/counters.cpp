#include "tests/support/counters.h"

#include <atomic>
#include <cstdlib>
#include <dlfcn.h>
#include <new>
#include <pthread.h>
#include <typeinfo>

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
#define PALPATE_SANITIZED 1
#else
#define PALPATE_SANITIZED 0
#endif

namespace {

thread_local bool counting = false;
thread_local palpate::test::Counts total;
// For FailScope: number of large allocations of all threads, and number of the one that fails.
std::atomic<bool> failing{false};
std::atomic<long> allocated{0};
std::atomic<long> fails{0};

/// Counts an allocation. Returns true if it must fail.
[[maybe_unused]] bool allocates(std::size_t size) {
  if (counting) ++total.allocations;
  return failing.load(std::memory_order_relaxed) && size >= palpate::test::FailScope::kLarge &&
         ++allocated == fails;
}

/// Returns the next library's function of this name.
template <class F>
F next(const char* name) {
  return reinterpret_cast<F>(dlsym(RTLD_NEXT, name));
}

}  // namespace

#if PALPATE_SANITIZED
// With a sanitizer, hooks count all allocations, because the sanitizer provides malloc.
extern "C" int __sanitizer_install_malloc_and_free_hooks(void (*allocated)(const volatile void*,
                                                                           std::size_t),
                                                         void (*freed)(const volatile void*));

namespace {

void onAllocated(const volatile void* /*p*/, std::size_t /*size*/) {
  if (counting) ++total.allocations;
}
void onFreed(const volatile void* /*p*/) {}
const int kHooked = __sanitizer_install_malloc_and_free_hooks(onAllocated, onFreed);

}  // namespace
#endif

extern "C" {

#if !PALPATE_SANITIZED
// glibc's second names of its allocation functions. This file replaces the first ones, to count
// their calls, including those by operator new.
void* __libc_malloc(std::size_t);
void* __libc_calloc(std::size_t, std::size_t);
void* __libc_realloc(void*, std::size_t);
void* __libc_memalign(std::size_t, std::size_t);

void* malloc(std::size_t size) {
  return allocates(size) ? nullptr : __libc_malloc(size);
}
void* calloc(std::size_t n, std::size_t size) {
  return allocates(n * size) ? nullptr : __libc_calloc(n, size);
}
void* realloc(void* p, std::size_t size) {
  return allocates(size) ? nullptr : __libc_realloc(p, size);
}

void* aligned_alloc(std::size_t alignment, std::size_t size) {
  return allocates(size) ? nullptr : __libc_memalign(alignment, size);
}

int pthread_mutex_lock(pthread_mutex_t* mutex) {
  static auto* real = next<int (*)(pthread_mutex_t*)>("pthread_mutex_lock");
  if (counting) ++total.locks;
  return real(mutex);
}
int pthread_mutex_trylock(pthread_mutex_t* mutex) {
  static auto* real = next<int (*)(pthread_mutex_t*)>("pthread_mutex_trylock");
  if (counting) ++total.locks;
  return real(mutex);
}
int pthread_rwlock_rdlock(pthread_rwlock_t* lock) {
  static auto* real = next<int (*)(pthread_rwlock_t*)>("pthread_rwlock_rdlock");
  if (counting) ++total.locks;
  return real(lock);
}
int pthread_rwlock_wrlock(pthread_rwlock_t* lock) {
  static auto* real = next<int (*)(pthread_rwlock_t*)>("pthread_rwlock_wrlock");
  if (counting) ++total.locks;
  return real(lock);
}
#endif

[[noreturn]] void __cxa_throw(void* object, void* type, void (*destroy)(void*)) {
  using Throw = void (*)(void*, void*, void (*)(void*));
  static auto* real = next<Throw>("__cxa_throw");
  if (counting) ++total.exceptions;
  real(object, type, destroy);
  std::abort();
}

}  // extern "C"

namespace palpate::test {

CountScope::CountScope() {
  total = {};
  counting = true;
}
CountScope::~CountScope() {
  counting = false;
}
Counts CountScope::counts() {
  return total;
}

FailScope::FailScope(long n) {
  allocated = 0;
  fails = n;
  failing = true;
}
FailScope::~FailScope() {
  failing = false;
}
bool FailScope::works() {
  return PALPATE_SANITIZED == 0;
}
long FailScope::seen() {
  return allocated;
}

}  // namespace palpate::test
