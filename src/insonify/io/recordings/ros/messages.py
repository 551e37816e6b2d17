"""The ROS 2 messages of a recording: their definitions, and ours turned into them and back.

Standard messages are those of ROS 2 Humble.  `marine_acoustic_msgs` is defined here, with the
fields of its release 2.  `insonify_msgs/msg/PingState` is our own: what a mapper was told of a
ping, unrounded, since the standard messages hold ranges in single precision and turns as
quaternions.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from insonify.frames import quaternion_from_rotation, transform_from_pose
from insonify.types import Array, FanGeometry, Float64, Ping, Pose, estimated
from insonify.vehicle.craft import DvlReading
from insonify.vehicle.instruments import DvlSettings, ImuSettings, beam_directions

IMAGE_FROM_SONAR = np.array(
    [[0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Our sonar frame (forward, left, up) in the frame of ProjectedSonarImage: z forward, x up, so y
to starboard.  It is its own inverse."""

DTYPES = ("u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f4", "f8")
"""SonarImageData's numbers for pixel types, in order."""

_DEFINITIONS = {
    "marine_acoustic_msgs/msg/PingInfo": """
float32 frequency
float32 sound_speed
float32[] tx_beamwidths
float32[] rx_beamwidths
""",
    "marine_acoustic_msgs/msg/SonarImageData": """
bool is_bigendian
uint32 DTYPE_UINT8=0
uint32 DTYPE_INT8=1
uint32 DTYPE_UINT16=2
uint32 DTYPE_INT16=3
uint32 DTYPE_UINT32=4
uint32 DTYPE_INT32=5
uint32 DTYPE_UINT64=6
uint32 DTYPE_INT64=7
uint32 DTYPE_FLOAT32=8
uint32 DTYPE_FLOAT64=9
uint32 dtype
uint32 beam_count
uint8[] data
""",
    "marine_acoustic_msgs/msg/ProjectedSonarImage": """
std_msgs/Header header
marine_acoustic_msgs/PingInfo ping_info
geometry_msgs/Vector3[] beam_directions
float32[] ranges
marine_acoustic_msgs/SonarImageData image
""",
    "marine_acoustic_msgs/msg/Dvl": """
uint8 DVL_MODE_BOTTOM=1
uint8 DVL_MODE_WATER=2
uint8 DVL_TYPE_PISTON=0
uint8 DVL_TYPE_PHASED_ARRAY=1
std_msgs/Header header
uint8 velocity_mode
uint8 dvl_type
geometry_msgs/Vector3 velocity
float64[9] velocity_covar
float64 altitude
float64 course_gnd
float64 speed_gnd
uint8 num_good_beams
float32 sound_speed
bool beam_ranges_valid
bool beam_velocities_valid
geometry_msgs/Vector3[4] beam_unit_vec
float64[4] range
float32[4] range_covar
float32[4] beam_quality
float32[4] beam_velocity
float32[4] beam_velocity_covar
""",
    "insonify_msgs/msg/PingState": """
# what the mapper was told of the ping with the same stamp, unrounded
# poses: x, y, z in metres, then roll, pitch, yaw in radians (intrinsic z, y, x); not a number
# where none was known
std_msgs/Header header
float64[6] pose
float64[6] truth
float64[6] mount
float64 azimuth_fov_rad
float64 elevation_fov_rad
float64 range_min_m
float64 range_max_m
uint32 beams
uint32 bins
# state of the noise's generator after the ping (NumPy's PCG64): state and increment, high word
# first, then what is left of a half-used draw; empty if the noise is not of a generator
uint64[] generator
# how far the pose may be off, standard deviations: position (m) and attitude (rad), each in the
# direction that is known least; 0 where it is exact, or nobody says
float64[2] pose_std
""",
}


@cache
def message_types() -> Typestore:
    """All message types that a recording of ours may hold."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types: Any = {}
    for name, text in _DEFINITIONS.items():
        types |= get_types_from_msg(text, name)
    store.register(types)
    return store


def new(kind: str, /, **fields: Any) -> Any:
    """A message of a type, ``package/Name``."""
    package, short = kind.split("/")
    return message_types().types[f"{package}/msg/{short}"](**fields)


def header(time_ns: int, frame: str) -> Any:
    """A std_msgs/Header."""
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    stamp = new("builtin_interfaces/Time", sec=seconds, nanosec=nanoseconds)
    return new("std_msgs/Header", stamp=stamp, frame_id=frame)


def vector(x: float, y: float, z: float) -> Any:
    """A geometry_msgs/Vector3."""
    return new("geometry_msgs/Vector3", x=float(x), y=float(y), z=float(z))


def sonar_image(ping: Ping, time_ns: int, frame: str, frequency_hz: float, speed_mps: float) -> Any:
    """A ping as ProjectedSonarImage: data range by range, the beams of one range side by side."""
    geometry = ping.geometry
    azimuths = geometry.beam_azimuths_rad
    # the y axis points to starboard, azimuths grow to port
    directions = [
        vector(0.0, -y, z) for y, z in zip(np.sin(azimuths), np.cos(azimuths), strict=True)
    ]
    pixels = np.ascontiguousarray(ping.image, "<f4")
    return new(
        "marine_acoustic_msgs/ProjectedSonarImage",
        header=header(time_ns, frame),
        ping_info=new(
            "marine_acoustic_msgs/PingInfo",
            frequency=frequency_hz,
            sound_speed=speed_mps,
            tx_beamwidths=np.full(geometry.beams, geometry.elevation_fov_rad, np.float32),
            rx_beamwidths=np.full(geometry.beams, geometry.beam_rad, np.float32),
        ),
        beam_directions=directions,
        ranges=geometry.bin_ranges_m.astype(np.float32),
        image=new(
            "marine_acoustic_msgs/SonarImageData",
            is_bigendian=False,
            dtype=DTYPES.index("f4"),
            beam_count=geometry.beams,
            data=pixels.reshape(-1).view(np.uint8),
        ),
    )  # fmt: skip


def polar_picture(ping: Ping, time_ns: int, frame: str) -> Any:
    """A ping as a grey sensor_msgs/Image for eyes alone, far ranges above, port to the left.

    What nothing is known of is black.
    """
    image = np.nan_to_num(ping.image[::-1])
    grey = np.round(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)
    bins, beams = grey.shape
    return new(
        "sensor_msgs/Image",
        header=header(time_ns, frame),
        height=bins,
        width=beams,
        encoding="mono8",
        is_bigendian=0,
        step=beams,
        data=np.ascontiguousarray(grey).reshape(-1),
    )


def words_from_generator(generator: np.random.Generator) -> Array:
    """The state of a PCG64 as six words; none of any other generator."""
    state = generator.bit_generator.state
    if state["bit_generator"] != "PCG64":
        return np.zeros(0, np.uint64)
    inner = state["state"]
    words = [w for n in (inner["state"], inner["inc"]) for w in (n >> 64, n & (2**64 - 1))]
    return np.array([*words, state["has_uint32"], state["uinteger"]], np.uint64)


def set_generator(generator: np.random.Generator, words: Array) -> None:
    """Put a PCG64 into a state that `words_from_generator` gave."""
    a, b, c, d, has, half = map(int, words)
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {"state": a << 64 | b, "inc": c << 64 | d},
        "has_uint32": has,
        "uinteger": half,
    }


def ping_state(
    ping: Ping, pose: Pose | None, truth: Pose | None, generator: Array, time_ns: int, frame: str
) -> Any:
    """What the mapper was told of a ping, unrounded, and the noise's generator after it."""
    geometry = ping.geometry
    unknown = np.full(6, np.nan)
    return new(
        "insonify_msgs/PingState",
        header=header(time_ns, frame),
        pose=unknown if pose is None else np.array(pose.numbers),
        truth=unknown if truth is None else np.array(truth.numbers),
        mount=np.array(geometry.mount.numbers),
        azimuth_fov_rad=geometry.azimuth_fov_rad,
        elevation_fov_rad=geometry.elevation_fov_rad,
        range_min_m=geometry.range_min_m,
        range_max_m=geometry.range_max_m,
        beams=geometry.beams,
        bins=geometry.bins,
        generator=generator,
        pose_std=np.array((0.0, 0.0) if pose is None else pose.std),
    )


def poses_from_state(state: Any) -> tuple[Pose | None, Pose | None]:
    """The pose and the true one that a PingState tells, to the last bit; None where it has none."""
    if np.isnan(state.pose).any():
        return None, None
    # recordings of version 0.1 do not tell how far it may be off
    pose = estimated(Pose(*map(float, state.pose)), getattr(state, "pose_std", (0.0, 0.0)))
    return pose, Pose(*map(float, state.truth))


def geometry_from_state(state: Any) -> FanGeometry:
    """The fan geometry of a PingState, to the last bit."""
    return FanGeometry(
        azimuth_fov_rad=float(state.azimuth_fov_rad),
        elevation_fov_rad=float(state.elevation_fov_rad),
        beams=int(state.beams),
        bins=int(state.bins),
        range_min_m=float(state.range_min_m),
        range_max_m=float(state.range_max_m),
        mount=Pose(*map(float, state.mount)),
    )


def _quaternion(rotation: Float64) -> Any:
    x, y, z, w = map(float, quaternion_from_rotation(rotation))
    return new("geometry_msgs/Quaternion", x=x, y=y, z=z, w=w)


def _pose(pose: Pose) -> Any:
    return new(
        "geometry_msgs/Pose",
        position=new("geometry_msgs/Point", x=pose.x_m, y=pose.y_m, z=pose.z_m),
        orientation=_quaternion(transform_from_pose(pose)[:3, :3]),
    )


def odometry(
    pose: Pose,
    time_ns: int,
    frame: str,
    velocity: Float64 | None = None,
    covariance: Float64 | None = None,
) -> Any:
    """A nav_msgs/Odometry of base_link.

    Args:
        pose: Where it is.
        time_ns: When.
        frame: Where to.
        velocity: (6,) m/s and rad/s, of base_link in its own frame; zero if it is not known.
        covariance: (6, 6) of position and attitude; by default of the pose's own deviations.
    """
    v = np.zeros(6) if velocity is None else velocity
    spread = np.diag(np.repeat(pose.std, 3) ** 2) if covariance is None else covariance
    twist = new("geometry_msgs/Twist", linear=vector(*v[:3]), angular=vector(*v[3:]))
    flat = np.ascontiguousarray(spread, np.float64).reshape(-1)
    return new(
        "nav_msgs/Odometry",
        header=header(time_ns, frame),
        child_frame_id="base_link",
        pose=new("geometry_msgs/PoseWithCovariance", pose=_pose(pose), covariance=flat),
        twist=new("geometry_msgs/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )


def imu(reading: Float64, time_ns: int, frame: str, settings: ImuSettings) -> Any:
    """A sensor_msgs/Imu of specific force and turn rate (6,); it knows no orientation."""
    force, rate = settings.accel_noise**2, settings.gyro_noise**2
    unknown = np.zeros(9)
    unknown[0] = -1.0
    return new(
        "sensor_msgs/Imu",
        header=header(time_ns, frame),
        orientation=new("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
        orientation_covariance=unknown,
        angular_velocity=vector(*reading[3:]),
        angular_velocity_covariance=(rate * settings.rate_hz * np.eye(3)).reshape(-1),
        linear_acceleration=vector(*reading[:3]),
        linear_acceleration_covariance=(force * settings.rate_hz * np.eye(3)).reshape(-1),
    )


def dvl(
    reading: DvlReading, time_ns: int, frame: str, settings: DvlSettings, speed_mps: float
) -> Any:
    """A marine_acoustic_msgs/Dvl; velocities along beams are positive towards the bottom.

    The velocity is the least squares of the beams that have an echo, not a number with fewer than
    three; the altitude is that of the nearest beam.
    """
    beams = beam_directions(settings)
    along, ranges = reading.velocities_m_s, reading.ranges_m
    good = np.isfinite(along)
    velocity, spread = np.full(3, np.nan), np.full((3, 3), np.nan)
    if good.sum() >= 3:
        velocity = np.linalg.lstsq(beams[good], along[good], rcond=None)[0]
        spread = settings.noise_m_s**2 * np.linalg.inv(beams[good].T @ beams[good])
    heights = -ranges * beams[:, 2]
    return new(
        "marine_acoustic_msgs/Dvl",
        header=header(time_ns, frame),
        velocity_mode=1,
        dvl_type=0,
        velocity=vector(*velocity),
        velocity_covar=spread.reshape(-1),
        altitude=float(heights[good].min()) if good.any() else float("nan"),
        course_gnd=float(np.arctan2(velocity[1], velocity[0])),
        speed_gnd=float(np.hypot(velocity[0], velocity[1])),
        num_good_beams=int(good.sum()),
        sound_speed=speed_mps,
        beam_ranges_valid=bool(good.any()),
        beam_velocities_valid=bool(good.any()),
        beam_unit_vec=[vector(*beam) for beam in beams],
        range=ranges.astype(np.float64),
        range_covar=np.zeros(4, np.float32),
        beam_quality=good.astype(np.float32),
        beam_velocity=along.astype(np.float32),
        beam_velocity_covar=np.full(4, settings.noise_m_s**2, np.float32),
    )


def path(waypoints: tuple[Pose, ...], time_ns: int, frame: str) -> Any:
    """A nav_msgs/Path."""
    head = header(time_ns, frame)
    poses = [new("geometry_msgs/PoseStamped", header=head, pose=_pose(pose)) for pose in waypoints]
    return new("nav_msgs/Path", header=head, poses=poses)


def transforms(links: list[tuple[str, str, Float64]], time_ns: int) -> Any:
    """A tf2_msgs/TFMessage of (parent, child, parent_from_child (4, 4))."""
    return new(
        "tf2_msgs/TFMessage",
        transforms=[
            new(
                "geometry_msgs/TransformStamped",
                header=header(time_ns, parent),
                child_frame_id=child,
                transform=new(
                    "geometry_msgs/Transform",
                    translation=vector(*transform[:3, 3]),
                    rotation=_quaternion(transform[:3, :3]),
                ),
            )
            for parent, child, transform in links
        ],
    )


def point_cloud(points: Array, names: tuple[str, ...], time_ns: int, frame: str) -> Any:
    """A sensor_msgs/PointCloud2 of rows of float32."""
    rows = np.ascontiguousarray(points, "<f4")
    fields = [
        new("sensor_msgs/PointField", name=name, offset=4 * k, datatype=7, count=1)
        for k, name in enumerate(names)
    ]
    return new(
        "sensor_msgs/PointCloud2",
        header=header(time_ns, frame),
        height=1,
        width=len(rows),
        fields=fields,
        is_bigendian=False,
        point_step=4 * len(names),
        row_step=4 * len(names) * len(rows),
        data=rows.reshape(-1).view(np.uint8),
        is_dense=True,
    )
