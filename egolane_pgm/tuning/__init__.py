"""Parameter search: Optuna studies over what graph and evidence rule declare.

`plan` says what is tuned, `space` within which bounds, `objective` scores parameters, `task` says
what a search knows of its recordings (`recording_task`), `sampler` is a sampler of our own,
`search` runs a study, `storage` opens the one that is kept, `nested` runs it anew without a part,
`study` does it all.
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from egolane_pgm.tuning.sampler import Shade

__all__ = ["Shade"]


def __getattr__(name: str) -> Any:
    # Optuna is imported only where it is used: commands that do not search begin at once.
    if name == "Shade":
        from egolane_pgm.tuning.sampler import Shade

        return Shade
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
