"""Scenes whose ray directions are known: influence areas, ray casters, and the analysis of trees for them."""
