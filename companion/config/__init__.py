"""Configuration: ``structures`` (what there is), ``loading`` (from TOML files), ``rules`` (what has to hold), and
``calibration`` (cameras as ROS and Kalibr write them).

Frozen, loaded once and passed down. A wrong file is one ``ConfigError`` that names file, field and unit.
"""

from companion.config.errors import ConfigError
from companion.config.loading import assemble, load, load_setup
from companion.config.structures import (
    FIRMWARE_CONFIGS,
    AirframeConfig,
    AttitudeResponse,
    BoomConfig,
    CameraConfig,
    CompanionConfig,
    CornerConfig,
    CornerPointConfig,
    DetectionConfig,
    FusionConfig,
    GuidanceConfig,
    LabelingConfig,
    LinksConfig,
    Setup,
    Struct,
    TankerConfig,
    TrimConfig,
    Vec3,
    VisionConfig,
    WindowConfig,
    landmarks,
)

__all__ = [
    "FIRMWARE_CONFIGS",
    "AirframeConfig",
    "AttitudeResponse",
    "BoomConfig",
    "CameraConfig",
    "CompanionConfig",
    "ConfigError",
    "CornerConfig",
    "CornerPointConfig",
    "DetectionConfig",
    "FusionConfig",
    "GuidanceConfig",
    "LabelingConfig",
    "LinksConfig",
    "Setup",
    "Struct",
    "TankerConfig",
    "TrimConfig",
    "Vec3",
    "VisionConfig",
    "WindowConfig",
    "assemble",
    "landmarks",
    "load",
    "load_setup",
]
