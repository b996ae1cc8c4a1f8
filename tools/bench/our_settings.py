"""Our contenders: the integrator, its error bound and its threads."""

import argparse

import msgspec

from mapperd.config import Config, Mapping, Octree, Sonar

APERTURE_DEG = 20.0
"""What the simulated sonar hears one way: the rivals' rays and our wedge span the same water."""

WAYS = ("rays", "exact", "default")
"""Sampled sub-rays; the projective integrator with error bound 0; the same with its default."""


def config_of(
    way: str, resolution_m: float, threads: int = 1, *, carve_no_return: bool = False
) -> Config:
    """Settings of a contender; all but aperture, integrator and grid are the defaults."""
    if way == "rays":
        mapping = Mapping(integrator="rays")
    else:
        bound = 0.0 if way == "exact" else Mapping().error_bound
        mapping = Mapping(error_bound=bound, threads=threads, carve_no_return=carve_no_return)
    return Config(
        sonar=Sonar(vertical_aperture=APERTURE_DEG),
        octree=Octree(voxel_resolution=resolution_m),
        mapping=mapping,
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What every program that runs our maps on the benchmark's pings is told."""
    parser.add_argument("pings", help="file of bench_pings")
    parser.add_argument("resolution_m", type=float)
    parser.add_argument("budget_s", type=float, help="begins no ping after so long")
    parser.add_argument("--first-returns", action="store_true", help="and nothing behind them")


def print_json(result: object) -> None:
    """Leave the result on standard output."""
    print(msgspec.json.encode(result).decode())
