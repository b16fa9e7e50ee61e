"""`lsnet-pipe simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from inspect_pipeline.commands.options import check_suffix, finite
from inspect_pipeline.commands.output import print_line
from inspect_pipeline.simulation.options import (
    FaultKind,
    FlightKind,
    RenderKind,
    SchemaKind,
    TowerKind,
    WeatherKind,
)

_LEAST_PX, _MOST_PX = 64, 8192


def _parse_size(text: str) -> tuple[int, int]:
    """Parse (height, width) from a text like 1280x720."""
    width, _, height = text.partition("x")
    is_size = width.isdecimal() and height.isdecimal()
    if not is_size or not all(_LEAST_PX <= int(side) <= _MOST_PX for side in (width, height)):
        raise typer.BadParameter(f"{text!r} is not a size like 1280x720, of {_LEAST_PX} to {_MOST_PX} px")
    return int(height), int(width)


def simulate(
    target: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="The recording to write (MCAP); or a folder, of photographs."),
    ],
    seconds: Annotated[
        float, typer.Option(min=0.1, metavar="S", callback=finite, help="Length of the flight.")
    ] = 20.0,
    fps: Annotated[
        float, typer.Option(min=0.1, metavar="N", callback=finite, help="Images per second.")
    ] = 2.0,
    size: Annotated[
        str, typer.Option(metavar="WIDTHxHEIGHT", help="Size of the images, in px.")
    ] = "1280x720",
    seed: Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the landscape and the line.")] = 0,
    flight: Annotated[FlightKind, typer.Option(help="Path of the drone.")] = FlightKind.PASS_BY,
    fault: Annotated[
        list[FaultKind] | None, typer.Option(help="Add a fault where the camera sees it; may be repeated.")
    ] = None,
    structures: Annotated[
        int | None,
        typer.Option(min=2, metavar="N", help="Towers of a line that ends. Default: it does not end."),
    ] = None,
    phases: Annotated[int, typer.Option(min=1, max=12, metavar="N", help="Phases side by side.")] = 3,
    bundle: Annotated[int, typer.Option(min=1, max=4, metavar="N", help="Conductors of a phase.")] = 1,
    circuits: Annotated[
        int, typer.Option(min=1, max=2, metavar="N", help="Circuits, one on either side.")
    ] = 1,
    position_noise: Annotated[
        float, typer.Option(min=0, metavar="M", callback=finite, help="Noise of each position, in m.")
    ] = 0.0,
    drift: Annotated[
        float, typer.Option(min=0, metavar="M", callback=finite, help="Slow error of positions, up to M.")
    ] = 0.0,
    attitude_noise: Annotated[
        float, typer.Option(min=0, metavar="DEG", callback=finite, help="Noise of the camera's angles.")
    ] = 0.0,
    corner: Annotated[
        float,
        typer.Option(min=-60, max=60, metavar="DEG", callback=finite, help="Turn of the line, to the left."),
    ] = 0.0,
    hills: Annotated[
        float, typer.Option(min=0, max=15, metavar="M", callback=finite, help="Height of hills, in m.")
    ] = 0.0,
    wind: Annotated[
        float, typer.Option(min=0, max=60, metavar="DEG", callback=finite, help="Swing of the conductors.")
    ] = 0.0,
    weather: Annotated[WeatherKind, typer.Option(help="Light of the pictures.")] = WeatherKind.CLEAR,
    towers: Annotated[TowerKind, typer.Option(help="Structures to draw.")] = TowerKind.WOOD,
    ground: Annotated[
        Path | None,
        typer.Option(metavar="PHOTO", help="Aerial photograph, 82 m wide, as the ground. Default: drawn."),
    ] = None,
    render: Annotated[
        RenderKind, typer.Option(help="Draw the conductors, or render them with Mitsuba (extra synth).")
    ] = RenderKind.DRAWN,
    schema: Annotated[
        SchemaKind, typer.Option(help="Schemas of the messages; or photographs, for pack.")
    ] = SchemaKind.FOXGLOVE,
    spans: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the spans here as GeoJSON, for spans import.")
    ] = None,
    terrain: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the ground here as an ASCII grid, for process --dem."),
    ] = None,
) -> None:
    """Simulate a flight along a power line.

    Writes a recording, or photographs, and the ground truth beside it as FILE.truth.json.

    \b
    Examples:
      lsnet-pipe simulate demo.mcap
      lsnet-pipe simulate demo.mcap --seconds 10 --fault missing_conductor
      lsnet-pipe simulate demo.mcap --phases 6 --position-noise 2 --drift 2 --attitude-noise 1
      lsnet-pipe simulate demo.mcap --hills 8 --corner 30 --terrain hills.asc
      lsnet-pipe simulate photos --schema photographs --fps 0.5
    """
    if schema != SchemaKind.PHOTOGRAPHS:
        check_suffix(target, (".mcap",))
    if spans:
        check_suffix(spans, (".geojson", ".json"))
    if terrain:
        check_suffix(terrain, (".asc",))
    from inspect_pipeline.simulation.write import SimulationOptions, simulate_flight

    options = SimulationOptions(
        seconds=seconds,
        fps=fps,
        image_size=_parse_size(size),
        seed=seed,
        flight=flight,
        n_structures=structures,
        n_phases=phases,
        n_bundle=bundle,
        n_circuits=circuits,
        position_noise_m=position_noise,
        drift_m=drift,
        attitude_noise_deg=attitude_noise,
        corner_deg=corner,
        hills_m=hills,
        wind_deg=wind,
        weather=weather,
        towers=towers,
        faults=tuple(fault or ()),
        schema=schema,
        ground=ground,
        render=render,
    )
    if terrain:
        from inspect_pipeline.simulation.terrain_file import check_terrain, write_terrain

        check_terrain(terrain, options)
    truth = simulate_flight(target, options)
    print_line(str(target))
    print_line(str(truth))
    if spans:
        from inspect_pipeline.simulation.span_file import write_spans

        write_spans(spans, truth)
        print_line(str(spans))
    if terrain:
        write_terrain(terrain, options)
        print_line(str(terrain))
