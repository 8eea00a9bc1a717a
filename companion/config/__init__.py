"""Configuration: ``structures`` (what there is), ``loading`` (from TOML files), ``rules`` (what has to hold), and
``calibration`` (cameras as ROS and Kalibr write them).

Frozen, loaded once and passed down. A wrong file is one ``ConfigError`` that names file, field and unit.
"""

from companion.config.base import Rules, Struct, Vec3
from companion.config.boom import BoomConfig
from companion.config.errors import ConfigError
from companion.config.estimation import FilterConfig, FusionConfig, IntegrityConfig
from companion.config.guidance import GuardConfig, GuidanceConfig
from companion.config.loading import assemble, load, load_setup
from companion.config.structures import (
    FIRMWARE_CONFIGS,
    AirframeConfig,
    AttitudeResponse,
    CameraConfig,
    CompanionConfig,
    CornerConfig,
    CornerPointConfig,
    DetectionConfig,
    LabelingConfig,
    LinksConfig,
    Setup,
    TankerConfig,
    TrimConfig,
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
    "FilterConfig",
    "FusionConfig",
    "GuardConfig",
    "GuidanceConfig",
    "IntegrityConfig",
    "LabelingConfig",
    "LinksConfig",
    "Rules",
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
