// The module that tells Python which of the compiled kernels this processor can run.
#include <nanobind/nanobind.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include "cpu_levels.hpp"

NB_MODULE(_cpu, m) { m.def("supported_levels", &supported_levels); }
