"""A dataset: labelled views of a world, and what is in them.

python examples/06_dataset.py [FOLDER]

`insonify dataset` does the same on all cores; docs/datasets.md has a loader for PyTorch.
"""

import sys
from pathlib import Path

import numpy as np
import xarray

from insonify.imaging.dataset import dataset_config
from insonify.results.dataset import write_dataset

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "build/examples") / "views"
folder.mkdir(parents=True, exist_ok=True)

config = dataset_config(
    "fls-structures",
    [{"count": 8, "sonar": {"beams": 128, "bins": 300}, "poses": {"depression_min_deg": 15.0}}],
)
write_dataset(config, folder)

views = xarray.open_zarr(folder / "dataset.zarr")
for number, name in enumerate(views.attrs["labels"]):
    seen = (views.label == number).sum(("bin", "beam")).values
    elevation = views.elevation_rad.where(views.label == number)
    print(
        f"{name}: in {np.count_nonzero(seen)} of {config.count} views, {seen.sum()} pixels, "
        f"mean elevation {np.degrees(float(elevation.mean())):+.1f} degrees"
    )
print(f"pictures and masks: {folder / 'images'}, {folder / 'masks'}")
