"""``gonio-mi doctor``: whether this machine is able to measure."""

__all__ = ["add", "run"]


def add(commands):
    """Add the parser of the command."""
    parser = commands.add_parser(
        "doctor",
        help="is this machine able to measure?",
        description="Find out whether this machine is able to measure; if it is not, "
        "say the line that fixes it.",
    )
    parser.set_defaults(run=run)


def run(_options):
    """Run the command and return the exit code."""
    from .. import doctor

    return doctor.run()
