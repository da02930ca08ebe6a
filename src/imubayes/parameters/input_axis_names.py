"""Names of the components of input axes, `input_axis[channel,component]`: written and read here alone."""

COMPONENTS = ("x", "y", "z")
_START = "input_axis["


def component_names(channel: str) -> tuple[str, ...]:
    """Return the names of the three components of a channel's input axis."""
    return tuple(f"{_START}{channel},{component}]" for component in COMPONENTS)


def channel_of_component(name: str) -> str | None:
    """Return the channel where a derived quantity is a component of its input axis; None of any other quantity."""
    return name.removeprefix(_START).rpartition(",")[0] if name.startswith(_START) else None
