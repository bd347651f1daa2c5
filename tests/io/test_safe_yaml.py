import os

import pytest

from quadrig.io.config.kalibr_target import read_target
from quadrig.io.safe_yaml import read_yaml
from quadrig.single.errors import QuadrigError


def test_names_for_names_are_refused_before_they_unfold():
    nest = b"a: &a [x, x, x, x, x, x, x, x, x]\n"
    nest += b"".join(
        f"{n}: &{n} [{','.join(9 * ['*' + o])}]\n".encode() for o, n in zip("abcdefgh", "bcdefghi", strict=True)
    )
    with pytest.raises(ValueError, match="aliases"):
        read_yaml(nest)


def test_a_pipe_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "target.yaml")
    with pytest.raises(QuadrigError, match="a pipe"):
        read_target(tmp_path / "target.yaml")
