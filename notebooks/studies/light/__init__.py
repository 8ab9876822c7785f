"""What the survey claims of packets by bounce, measured with the rays of path tracing."""
