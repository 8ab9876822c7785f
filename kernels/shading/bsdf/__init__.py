"""How surfaces scatter light: Fresnel's equations, the GGX distribution, materials, and nested dielectrics."""
