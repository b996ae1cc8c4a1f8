"""Whether localization can follow settings, before they hold."""

from mapperd.config.tree import Config
from mapperd.errors import ConfigError
from mapperd.localization.models import beam_model, filter_rule, hit_model

__all__ = ["check_localization"]


def check_localization(config: Config) -> None:
    """Check what the filter and its models will be asked to take.

    Raises:
        ConfigError: they refuse it.
    """
    if config.localization.mode == "off":
        return
    try:
        filter_rule(config)
        hit_model(config.amcl)
        if config.amcl.laser_model_type == "beam":
            beam_model(config.amcl)
    except ValueError as error:
        raise ConfigError(f"$.amcl: {error}", "$.amcl") from error
