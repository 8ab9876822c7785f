"""From a plan to answers: prepared queries, batches, and their launches."""
