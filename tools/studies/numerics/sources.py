"""Which sources hold single precision: each is measured by one row of the page, or has a reason."""

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
        "client/mirror.py compat/sonar_to_3d.py "
        "export/calibration.py export/clouds.py mapping/queries.py "
        "mapping/sonar_map.py",
    ),
    "`echo`": _in("mapperd/", "imaging/ping_image.py"),
    "`evidence_grid`, `kernels`, `iwlo`": (
        *_in("cpp/map/include/mapperd/map/", "kernels.hpp ping.hpp polar_grid.hpp"),
        *_in(
            "cpp/map/src/",
            "evidence_grid.cpp evidence_integrator.cpp iwlo.cpp kernels_body.hpp "
            "lanes_body.hpp polar_grid.cpp rays.cpp",
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
    "`crosstalk`, `robots`": _in("mapperd/", "imaging/crosstalk.py imaging/robots.py"),
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
    "pictures of pings": _in("oculus_driver/", "fan.py render/painter.py ping.py"),
    "`meshes`, `tracing`": (
        "cpp/common/include/mapperd/common/vec.hpp",
        "cpp/python/acoustics/tracing.cpp",
        *_in(ACOUSTICS, "mesh_edges.cpp morton.hpp neighbours.cpp ray_bundle.cpp silhouettes.cpp"),
        *_in(HEARD, "mesh_edges.hpp neighbours.hpp ray_bundle.hpp silhouettes.hpp"),
        *_in(
            SIMULATOR,
            "navigation/odometry_output.py propagation/ground_truth.py "
            "propagation/mirror.py propagation/propagation_path.py "
            "propagation/refraction.py raycast/depth_camera.py raycast/fan.py "
            "raycast/meshes.py raycast/tracing.py",
        ),
    ),
    "`footprint`, `scatter_*`": (
        "cpp/python/acoustics/scatter.cpp",
        *_in(ACOUSTICS, "bands.cpp footprint.cpp patches.cpp scatter_field.cpp scatter_power.cpp"),
        *_in(HEARD, "footprint.hpp scatter.hpp"),
    ),
    "`nodes`": _in(ACOUSTICS, "nodes.cpp nodes.hpp"),
    "`deposit`, `random`, `echo_response`": (
        *_in(ACOUSTICS, "complex_gaussian.cpp deposit.cpp cells.cpp"),
        *_in(HEARD, "cells.hpp complex_gaussian.hpp deposit.hpp echo_response.hpp"),
        *_in(
            SIMULATOR,
            "engine.py propagation/clouds.py propagation/point_targets.py receiver/noise.py",
        ),
    ),
    "`convolution`, `beams`": (
        "cpp/python/acoustics/receiving.cpp",
        *_in(ACOUSTICS, "convolution.cpp convolution.hpp beams.cpp"),
        HEARD + "beams.hpp",
        SIMULATOR + "receiver/beamformer.py",
    ),
    "`receiver`, `fast_math`": (
        ACOUSTICS + "receiver.cpp",
        HEARD + "receiver.hpp",
        "cpp/common/include/mapperd/common/fast_math.hpp",
        SIMULATOR + "receiver/gain.py",
    ),
}
"""Sources by the row that measures them."""

NOT_MEASURED: dict[str, tuple[str, ...]] = {
    "drawn by a browser or a viewer, whose own width it is": (
        *_in(
            "mapperd/",
            "foxglove/geometry.py foxglove/map_publisher.py foxglove/messages.py "
            "viewer/chunks.py viewer/colours.py viewer/map_layer.py viewer/sonar_panel.py "
            "viewer/tools.py",
        ),
        SIMULATOR + "page/scene_view.py",
    ),
    "serves the rules that decide on effects, to tenths of a decibel": (
        ACOUSTICS + "preview.cpp",
        HEARD + "preview.hpp",
        "cpp/python/acoustics/previewing.cpp",
        *_in(
            SIMULATOR,
            "effects/coarse_picture.py effects/image_difference.py "
            "effects/multipath.py effects/preview.py effects/previewer.py effects/rule_check.py "
            "effects/texture.py",
        ),
    ),
    "the published plugin's arithmetic in the widths that it has": _in(
        SIMULATOR + "classic/",
        "defects.py pipeline.py scan.py writer.py",
    ),
    "hands on what other sources made": (
        "cpp/map/src/ping_box.cpp",
        "mapperd/alignment/report.py",
        *_in("mapperd/bridges/", "dds.py mavlink.py ros2_messages.py"),
        "mapperd/imaging/filter_chain.py",
        "mapperd/localization/map_io.py",
        "tools/mapper_survey/spool.py",
        *_in(
            SIMULATOR,
            "geometry/matmul.py products/arrays.py products/images.py "
            "products/point_cloud.py products/sounding.py scanning.py "
            "scene_file/gltf.py simulator.py",
        ),
    ),
    "fitted to images in double precision, whose samples have 8 bits": _in(
        "mapperd/", "calibration/agreement.py calibration/dive.py odometry/sonar_odometry.py"
    ),
    "the arc rule's levels, in steps of half a decibel; test_arc.cpp compares with doubles": (
        "cpp/map/include/mapperd/map/arc_integrator.hpp",
        "cpp/map/include/mapperd/map/arc_model.hpp",
        "cpp/map/src/arc_integrator.cpp",
        "cpp/map/src/arc_model.cpp",
        "mapperd/mapping/arc.py",
        "mapperd/mapping/ping_log.py",
        "oculus_driver/noise.py",
    ),
    "checks of the simulator, which run beside it": _in(
        SIMULATOR + "validation/",
        "propagation.py receiver.py recording.py repeatability.py scattering.py setups.py tank.py",
    ),
}
"""Those that no row measures, by the reason."""
