"""Voxel maps, and the inverse sensor models that fill them from pings."""
