"""From rays to answers: the plan, the prepared kernel, and the launch."""
