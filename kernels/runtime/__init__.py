"""The host side of kernels: how many cores there are, the pool of threads that runs CPU kernels, and its schedules."""
