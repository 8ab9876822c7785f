"""Batches on several processes and GPUs: measured on this machine, simulated beyond it."""
