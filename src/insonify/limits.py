"""What a file may ask for: each figure that caps it, in one place; docs/limits.md says why.

They are far above what real data has, and far below what fills a small machine or takes minutes.
"""

from __future__ import annotations

MOST_PIXELS = 64_000_000
"""Of a sonar image, a normal map or another picture."""
MOST_HEIGHTS = 25_000_000
"""Of a height map or seabed, which become twice as many triangles; 5000 x 5000 are inside."""

MOST_ROUTE_PINGS = 1_000_000
"""Along a route with times."""
MOST_TOML_BYTES = 16 << 20
MOST_KEY_DOTS = 100
"""Of a TOML key; what reads them keeps every beginning of one."""
MOST_XML_BYTES = 256 << 20
MOST_XML_DEPTH = 200
MOST_XML_ELEMENTS = 2_000_000

MOST_INCLUDES = 2_000
"""Models that a world includes, directly or through others."""
MOST_INCLUDE_DEPTH = 32
MOST_FRAMES = 1_000
"""Of a world, each placed in another."""
MOST_BODIES = 20_000
MOST_TRIANGLES = 20_000_000
"""Of all shapes of a world, or of a mesh; a sphere has 20,480."""
MOST_WORLD_PIXELS = 2 * MOST_PIXELS
"""Of all normal maps of a world."""
MOST_NODES = 20_000
"""Nodes of a mesh's scene: its parts in their places."""
MOST_NODE_DEPTH = 100

FARTHEST_POSE = 1e9
"""Metres or radians; a map's origin, which is a place of some country's grid, lies as far."""
MOST_SETTING = 1e12
"""Of any number in a config."""
FARTHEST_M = 1e6
"""Places and sizes of what is simulated: beyond, single precision is coarser than a voxel."""
LARGEST_REFLECTANCE = 1e3
LAMBERT_DB = (-200.0, 60.0)
LEAST_VOXEL_M, LARGEST_VOXEL_M = 1e-4, 1e4

MOST_LOG_BYTES = 1 << 30
"""Of a telemetry log, which is read whole."""
MOST_MESSAGE_BYTES = 64 << 20
"""Of one message of a device."""
MOST_CHUNK_BYTES = 256 << 20
"""A chunk of an MCAP, unpacked; recorders write some megabytes."""
LEAST_CHUNK_BYTES, CHUNK_GROWTH = 16 << 20, 2_000
"""A chunk may unpack to so many bytes whatever its size, and to more by so many times its size."""
MOST_DEFINITION_BYTES = 1 << 20
MOST_FIELDS, MOST_FIELDS_IN_ALL = 2_000, 50_000
"""Of a message's definition with all it names, and of all definitions of a bag."""
MOST_UNROLLED = 2_000
"""Strings and messages in arrays whose length a definition fixes; numbers do not count."""

LEAST_BLOCKS, BLOCKS_PER_BYTE = 100_000, 64
"""A tree of an OctoMap may unfold to so many blocks whatever its size, and to more by its bytes."""

LEAST_ADDRESS_SPACE_BYTES = 1536 << 20
"""Not of a file: what ``ulimit -v`` must leave for numba, LLVM and the ray tracer to be loaded."""
