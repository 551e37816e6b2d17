"""The papers' planner: scan next where the map's uncertainty can be resolved."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from pydantic import Field

from insonify.config.settings import Settings
from insonify.mapping.mapper import Belief
from insonify.mapping.voxels import VoxelWindow
from insonify.planning.baselines import path_over_centre
from insonify.planning.candidates import candidate_poses, standoff_radius, straight_path
from insonify.planning.clusters import Cluster, largest_cluster
from insonify.planning.decision import Decision, Look, SurveyArea
from insonify.planning.entropy import entropy_map, high_entropy_voxels
from insonify.planning.gain import expected_gain
from insonify.types import FanGeometry, Float32, Float64, Nav, StopReason


class Standoff(StrEnum):
    """How far from the cluster's centre the candidate circle lies."""

    AXIS = "axis"
    CLUSTER = "cluster"


class Counted(StrEnum):
    """Whose entropy H_sum adds up when candidates are compared (eq. 6 and 7)."""

    CLUSTER = "cluster"
    REGION = "region"


class EntropySettings(Settings):
    """Parameters of the entropy planner."""

    high_entropy: float = Field(
        0.99, gt=0, le=1, description="least entropy of an undecided voxel (Table 1)"
    )
    eps_voxels: float = Field(1.75, gt=0, lt=64, description="DBSCAN radius, in voxels")
    min_samples: int = Field(10, ge=1, description="DBSCAN density, the voxel itself counted")
    candidates: int = Field(20, ge=1, le=3600, description="N, poses on the circle")
    termination: float = Field(
        0.3, ge=0, le=1, description="TC: stop if no pose sees more of C_max's entropy (Table 1)"
    )
    standoff: Standoff = Field(
        Standoff.AXIS,
        description="axis: the sonar's axis meets the centre; cluster: eq. 4 to the letter",
    )
    counted: Counted = Field(
        Counted.CLUSTER, description="voxels that H_sum counts: cluster, or the whole region"
    )
    max_scans: int = Field(12, ge=1, description="stop after so many scans in any case")


class EntropyPlanner:
    """Active scanning by entropy (Park et al. 2025, Fig. 2)."""

    name = "entropy"

    def __init__(self, area: SurveyArea, geometry: FanGeometry, settings: EntropySettings) -> None:
        """Plan scans of an area with a sonar."""
        self.area = area
        self.geometry = geometry
        self.settings = settings

    def next_scan(self, belief: Belief, nav: Nav) -> Decision:
        """The path that resolves most, or the reason why none is worth flying."""
        if not nav.scans:
            return Decision(path=path_over_centre(self.area, self.area.heading_rad))
        window = belief.voxels.window(self.area.region)
        entropy = entropy_map(window)
        cluster = self._most_uncertain(window, entropy)
        if cluster is None:
            return Decision(stop=StopReason.NO_CLUSTER)
        look = self._look_around(belief, window, entropy, cluster)
        if look.h_cluster.max() <= self.settings.termination * cluster.entropy:  # eq. 9
            return Decision(stop=StopReason.NOT_WORTH_IT, look=look)
        if len(nav.scans) >= self.settings.max_scans:
            return Decision(stop=StopReason.SCAN_LIMIT, look=look)
        best = look.candidates[look.best]  # P_next, eq. 7
        x_c, y_c, _ = cluster.centre_m
        return Decision(path=straight_path(best, (x_c, y_c), self.area.waypoints), look=look)

    def _most_uncertain(self, window: VoxelWindow, entropy: Float32) -> Cluster | None:
        """C_max of the undecided voxels."""
        undecided = high_entropy_voxels(window, entropy, self.settings.high_entropy)
        return largest_cluster(
            np.argwhere(undecided) + window.first,
            entropy[undecided],
            window.voxel_m,
            self.settings.eps_voxels * window.voxel_m,
            self.settings.min_samples,
        )

    def _look_around(
        self, belief: Belief, window: VoxelWindow, entropy: Float32, cluster: Cluster
    ) -> Look:
        """Score the candidates around a cluster (eq. 4 to 7)."""
        z_m = self.area.z_m
        radius_m = cluster.radius_m
        if self.settings.standoff is Standoff.AXIS:
            radius_m = standoff_radius(cluster, z_m, self.geometry)
        poses = candidate_poses(cluster, radius_m, z_m, self.settings.candidates)

        def seen(voxels_m: Float64, bits: Float32) -> Float64:
            return expected_gain(belief, poses, self.geometry, voxels_m, bits)

        h_cluster = seen(cluster.voxels_m, cluster.voxel_entropy)
        h_sum = h_cluster
        if self.settings.counted is Counted.REGION:
            everywhere = np.ones(entropy.shape, bool)
            h_sum = seen(window.centres_m(everywhere), entropy.ravel())
        best = int(np.argmax(h_sum))
        return Look(cluster, poses, h_sum, h_cluster, best, self.settings.termination)
