// Run by CMake when it configures: which kernels this machine can run, as a CMake list.
#include <cstdio>

#include "cpu_levels.hpp"

int main() {
    const char* separator = "";
    for (const std::string& level : supported_levels()) {
        std::printf("%s%s", separator, level.c_str());
        separator = ";";
    }
}
