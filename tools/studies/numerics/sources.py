"""Which sources hold single precision: each is measured by one row of the page, or said why not."""

__all__ = ["MEASURED", "NOT_MEASURED"]

ACOUSTICS, HEARD = "cpp/acoustics/src/", "cpp/acoustics/include/mapperd/acoustics/"
SIMULATOR = "tools/sonar_sim/"


def _in(folder: str, names: str) -> tuple[str, ...]:
    return tuple(folder + name for name in names.split())


MEASURED: dict[str, tuple[str, ...]] = {
    "`VoxelMap.query`, `voxels`; `.ot` files": _in(
        "cpp/",
        "map/include/mapperd/map/voxel_map.hpp python/points.hpp python/map.cpp "
        "map/src/octomap_tree.cpp map/src/octomap_write.cpp",
    ),
    "`mapping.Voxels`, `map_queries`, the client's mirror, LAS": _in(
        "mapperd/",
        "client/block_table.py client/mirror.py compat/sonar_to_3d.py "
        "export/calibration.py export/clouds.py export/las.py mapping/queries.py "
        "mapping/sonar_map.py",
    ),
    "`echo`": _in("mapperd/", "imaging/ping_image.py"),
    "`evidence_grid`, `kernels`, `iwlo`": (
        *_in("cpp/map/include/mapperd/map/", "evidence_grid.hpp kernels.hpp ping.hpp"),
        *_in(
            "cpp/map/src/",
            "evidence_grid.cpp evidence_integrator.cpp iwlo.cpp kernels_body.hpp rays.cpp",
        ),
    ),
    "`distance_field`, `volume_map`": (
        *_in(
            "cpp/",
            "map/include/mapperd/map/distance_field.hpp map/src/distance_field.cpp "
            "python/queries.cpp",
        ),
        "mapperd/localization/maps.py",
    ),
    "`likelihood_field`": _in(
        "cpp/",
        "localization/include/mapperd/localization/likelihood_field.hpp "
        "localization/src/likelihood_field.cpp python/localization_maps.cpp",
    ),
    "`field_weight`": ("cpp/localization/src/field_weight.cpp",),
    "`levels`, `first_return`": _in("mapperd/", "localization/detector.py"),
    "`fft_notch`, `crosstalk`, `robot_bands`": _in(
        "mapperd/", "imaging/crosstalk.py imaging/fft_notch.py imaging/robot_bands.py"
    ),
    "`stream.way`, particles, `topside`": _in(
        "mapperd/",
        "client/validation.py server/state_feed.py viewer/actors.py viewer/shapes.py "
        "wire/blocks.py",
    ),
    "`stream.pictures`": ("mapperd/server/state_messages.py",),
    "GeoTIFF": (
        "mapperd/export/geotiff.py",
        *_in("tools/mapper_survey/", "coverage.py export.py"),
    ),
    "pictures of pings": _in("oculus_driver/", "render/fan.py render/painter.py ping.py"),
    "`meshes`, `tracing` (Embree)": (
        "cpp/python/acoustics/tracing.cpp",
        ACOUSTICS + "neighbours.cpp",
        HEARD + "neighbours.hpp",
        *_in(
            SIMULATOR,
            "bent.py bounce.py fan.py meshes.py paths.py pinhole.py spans.py tracing.py truth.py "
            "navigation/altimeter.py",
        ),
    ),
    "`footprint`, `placing`, `nodes`, `scatter_*`": (
        "cpp/python/acoustics/scatter.cpp",
        *_in(
            ACOUSTICS,
            "footprint.cpp nodes.cpp nodes.hpp placing.cpp scatter_field.cpp scatter_power.cpp",
        ),
        *_in(HEARD, "footprint.hpp scatter.hpp"),
    ),
    "`deposit`, `random`, `hearing`": (
        *_in(ACOUSTICS, "complex_gaussian.cpp deposit.cpp cells.cpp"),
        *_in(HEARD, "cells.hpp complex_gaussian.hpp deposit.hpp hearing.hpp"),
        *_in(SIMULATOR, "between.py cells.py clouds.py engine.py targets.py"),
    ),
    "`convolution`, `beams`": (
        "cpp/python/acoustics/receiving.cpp",
        *_in(ACOUSTICS, "convolution.cpp convolution.hpp beams.cpp"),
        HEARD + "beams.hpp",
        SIMULATOR + "beams.py",
    ),
    "`receiver`, `fast_math`": (
        ACOUSTICS + "receiver.cpp",
        HEARD + "receiver.hpp",
        "cpp/common/include/mapperd/common/fast_math.hpp",
        SIMULATOR + "receiver.py",
    ),
}
"""Sources by the row that measures them."""

NOT_MEASURED: dict[str, tuple[str, ...]] = {
    "writes any array in its own width": ("mapperd/store/checkpoint_writer.py",),
    "drawn by a browser or a viewer, whose own width it is": _in(
        "mapperd/",
        "foxglove/geometry.py foxglove/map_publisher.py foxglove/messages.py "
        "viewer/chunks.py viewer/colours.py viewer/map_layer.py viewer/tools.py",
    ),
    "serves the rules that decide on effects, to tenths of a decibel": _in(
        SIMULATOR,
        "picture_change.py rule_check.py texture.py effects/coarse.py effects/ghosts.py "
        "effects/plumes.py effects/rays.py",
    ),
    "the published plugin's arithmetic in the widths that it has": _in(
        SIMULATOR + "classic/",
        "level_defects.py normals.py pipeline.py scan.py shape_defects.py shapes.py snr.py "
        "visual.py writer.py",
    ),
    "hands on what other sources made": (
        "cpp/map/src/ping_box.cpp",
        "tools/mapper_survey/spool.py",
        *_in(
            SIMULATOR,
            "product.py simulator.py products/arrays.py products/cells.py products/cloud.py "
            "products/pictures.py products/raw_scan.py products/sounding.py",
        ),
    ),
    "checks of the simulator, which run beside it": _in(
        SIMULATOR + "validation/",
        "homogeneous.py recording.py v05_plate.py v06_beam_pattern.py v10_mirror_ghosts.py "
        "v14_quantiser.py v17_no_wrap.py v18_classic.py v19_determinism.py v20_tank.py",
    ),
}
"""Those that no row measures, by the reason."""
