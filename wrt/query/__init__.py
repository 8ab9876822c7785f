"""What a scene answers: closest hits, occlusion, all hits, counts, inside tests, visibility."""
