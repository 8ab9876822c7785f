"""The host side of kernels: compiler options, cores, the thread pool that runs CPU kernels, packed arguments, and schedules."""
