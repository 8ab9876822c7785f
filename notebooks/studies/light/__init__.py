"""Secondary rays: packets by bounce, shading in streams, shadow rays."""
