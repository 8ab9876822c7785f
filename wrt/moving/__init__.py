"""Scenes of things that move, beside those of `wrt.scene`: how groups are joined, and skins that follow bones."""
