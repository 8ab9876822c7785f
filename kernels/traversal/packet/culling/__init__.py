"""Packet cullings: one file per published technique."""
