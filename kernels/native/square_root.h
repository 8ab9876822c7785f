// Square roots that are correctly rounded on every device.
#pragma once

namespace wrt {
namespace {

inline CUDA_CALLABLE float square_root(float x)
{
#if defined(__CUDA_ARCH__)
    return sqrtf(x);
#else
    return __builtin_sqrtf(x);
#endif
}

inline CUDA_CALLABLE double square_root(double x)
{
#if defined(__CUDA_ARCH__)
    return sqrt(x);
#else
    return __builtin_sqrt(x);
#endif
}

}  // namespace
}  // namespace wrt
