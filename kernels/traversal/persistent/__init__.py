"""Single rays on CUDA by persistent threads, which fetch rays."""
