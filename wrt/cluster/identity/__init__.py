"""What a job is: its scene, its rays and its options, as hashes and as text that is the same in every process."""
