"""Your own mapper, beside the paper's: a ping counts only where its echoes are not alone.

python examples/08_own_mapper.py, or from the command line:

insonify scan tetrapod --mapper examples/08_own_mapper.py:Despeckled
"""

import dataclasses

from scipy.ndimage import median_filter

from insonify import BayesMapper, execute, scenario_config


class Despeckled(BayesMapper):
    """The papers' update on images whose lone bright pixels are taken out."""

    name = "despeckled"

    def __init__(self, settings, width=3):
        """`width` can be set: --set mapper_options.width=5."""
        super().__init__(settings)
        self.width = width

    def integrate(self, ping, pose):
        """Filter along the range, then update."""
        image = median_filter(ping.image, size=(self.width, 1))
        super().integrate(dataclasses.replace(ping, image=image), pose)


if __name__ == "__main__":
    config = scenario_config("tetrapod", [{"mapping": {"voxel_m": 0.2}}])
    for mapper in (Despeckled(config.mapping), None):
        result = execute(config, mapper=mapper).result()
        f1 = result.metrics["solid"]["exact"]["f1"]
        print(f"{result.mapper}: {result.scans} scans, solid F1 {f1:.3f}")
