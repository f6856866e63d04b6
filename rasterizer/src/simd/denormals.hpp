// Treats denormal numbers (below 1.2e-38) as zero on this thread while an object of this class lives.
//
// Adam's first moment of a Gaussian that no view shows shrinks by β1 a step. After some 700 steps it is
// denormal, remains so, and each operation on it takes a hundred times as long (a quarter of a late iteration
// on lego).
#pragma once

#if defined(__SSE2__)
#include <immintrin.h>
#endif

namespace splat {

class FlushDenormals {
public:
    FlushDenormals(const FlushDenormals&) = delete;
    FlushDenormals& operator=(const FlushDenormals&) = delete;
#if defined(__SSE2__)
    FlushDenormals() : before_(_mm_getcsr()) { _mm_setcsr(before_ | kFlushResults | kZeroOperands); }
    ~FlushDenormals() { _mm_setcsr(before_); }

private:
    static constexpr unsigned kFlushResults = 1u << 15, kZeroOperands = 1u << 6;
    unsigned before_;
#else
    FlushDenormals() = default;
#endif
};

}  // namespace splat
