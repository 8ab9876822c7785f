"""Native loops over W lanes, in C++ that Clang and NVRTC compile."""
