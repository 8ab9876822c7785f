"""Trees that are built for known rays (ray distributions)."""
