"""Linear algebra in one thread where matrices are small: handing them to others takes longer than the work itself."""

from collections.abc import Callable
from functools import cache, wraps
from typing import TYPE_CHECKING, Concatenate, ParamSpec, TypeVar

from quadrig.rig.problem.build import Problem

if TYPE_CHECKING:
    from threadpoolctl import ThreadpoolController

P = ParamSpec("P")
R = TypeVar("R")

# From so many cameras on, and some thousand unknowns, a second thread wins.
_MANY = 100


def one_thread(solve: Callable[Concatenate[Problem, P], R]) -> Callable[Concatenate[Problem, P], R]:
    """What solves a problem, in one thread where its cameras are few."""

    @wraps(solve)
    def solving(problem: Problem, *args: P.args, **kwargs: P.kwargs) -> R:
        if len(problem.cameras) >= _MANY:
            return solve(problem, *args, **kwargs)
        with _threads().limit(limits=1, user_api="blas"):
            return solve(problem, *args, **kwargs)

    return solving


@cache
def _threads() -> "ThreadpoolController":
    # Loaded when it is used, for it looks at every library of the process.
    import scipy.linalg  # noqa: F401 - its own BLAS must be there to be found
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
