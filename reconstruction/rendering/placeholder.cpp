#include "native.h"
S4_API int reconstruction_native() { return 1; }
