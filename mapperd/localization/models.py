"""Converts the settings of localization to parameters of the core's filter, and checks them."""

import numpy as np

from mapperd.config.tree import AmclConfig, Config
from mapperd.errors import ConfigError
from mapperd.localization.maps import GridMap, LocalizationMap, VolumeMap
from mapperd.localization.particle_filter import (
    BeamModel,
    FilterParams,
    Grid,
    HitModel,
    LikelihoodField,
)

__all__ = [
    "beam_model",
    "check_localization",
    "core_grid",
    "field_of",
    "filter_params",
    "hit_model",
]


def filter_params(config: Config, *, plain: bool = False) -> FilterParams:
    """Return the parameters of resampling and recovery; `plain` never weakens likelihoods."""
    amcl, ours = config.amcl, config.localization
    return FilterParams(
        min_particles=amcl.min_particles,
        max_particles=amcl.max_particles,
        kld_error=amcl.pf_err,
        kld_quantile=amcl.pf_z,
        bucket_x_m=amcl.spatial_resolution_x,
        bucket_y_m=amcl.spatial_resolution_y,
        bucket_yaw_rad=amcl.spatial_resolution_theta,
        alpha_slow=amcl.recovery_alpha_slow,
        alpha_fast=amcl.recovery_alpha_fast,
        resample_interval=amcl.resample_interval,
        selective=amcl.selective_resampling,
        least_effective_share=0.0 if plain else ours.least_effective_share,
        draw_exponent=ours.draw_exponent,
    )


def hit_model(amcl: AmclConfig, sigma_m: float | None = None) -> HitModel:
    """Return the likelihood of a return by its distance to a surface; None uses the settings."""
    return HitModel(
        z_hit=amcl.laser_z_hit,
        z_rand=amcl.laser_z_rand,
        sigma_hit_m=amcl.laser_sigma_hit if sigma_m is None else sigma_m,
        max_range_m=amcl.laser_max_range,
        max_distance_m=amcl.laser_likelihood_max_dist,
    )


def beam_model(amcl: AmclConfig) -> BeamModel:
    """Return the likelihood of a range where another one is expected."""
    return BeamModel(
        z_hit=amcl.laser_z_hit,
        z_short=amcl.laser_z_short,
        z_max=0.0,  # beams without a return carry no information
        z_rand=amcl.laser_z_rand,
        sigma_hit_m=amcl.laser_sigma_hit,
        lambda_short_per_m=amcl.laser_lambda_short,
        max_range_m=amcl.laser_max_range,
    )


def core_grid(grid: GridMap) -> Grid:
    """Return the planar map as the core takes it."""
    origin = np.array([grid.origin_x_m, grid.origin_y_m, grid.origin_yaw_rad])
    return Grid(grid.occupancy, grid.resolution_m, origin)


def field_of(
    known: LocalizationMap, config: Config, sigma_m: float | None = None
) -> LikelihoodField:
    """Return the likelihood field of a map, one layer per height; None uses the settings."""
    model = hit_model(config.amcl, sigma_m)
    if isinstance(known, VolumeMap):
        distances = (known.distances_m, known.first_centre_m, known.resolution_m)
        return LikelihoodField.of_distances(*distances, model)
    boundaries = config.localization.boundaries_only
    return LikelihoodField.of_grid(core_grid(known), model, boundaries)


def check_localization(config: Config) -> None:
    """Check that the filter and its models accept the settings.

    Raises:
        ConfigError: they do not.
    """
    if config.localization.mode == "off":
        return
    try:
        filter_params(config)
        hit_model(config.amcl)
        if config.amcl.laser_model_type == "beam":
            beam_model(config.amcl)
    except ValueError as error:
        raise ConfigError(f"$.amcl: {error}", "$.amcl") from error
