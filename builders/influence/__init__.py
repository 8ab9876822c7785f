"""Influence areas: parts of a scene where ray directions are known, and the costs that follow."""
