"""The host side of kernels: available cores, the thread pool that runs CPU kernels, packed arguments, and schedules."""
