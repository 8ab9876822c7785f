"""What a scene answers: closest hits, occlusion, all hits, counts, closest points, inside tests, visibility."""
