// Which x86-64 instruction level this processor has; asked of the lowest build before a higher one is loaded.
#include "native.h"

S4_API int native_x86_level() {
#if defined(__x86_64__)
  __builtin_cpu_init();
  if (__builtin_cpu_supports("x86-64-v4")) return 4;
  if (__builtin_cpu_supports("x86-64-v3")) return 3;
  return 2;
#else
  return 0;
#endif
}
