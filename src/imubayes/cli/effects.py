"""`imubayes effects`: the catalogue."""


def effects(name: str | None = None) -> int:
    """List the catalogue of effects, or explain one.

    Example: imubayes effects gyro_g_sensitivity

    Parameters
    ----------
    name
        The effect to explain.
    """
    from imubayes.cli.session import start_jax

    start_jax()
    from imubayes.report.catalogue import print_catalogue, print_effect

    if name is None:
        print_catalogue()
    else:
        print_effect(name)
    return 0
