"""However an interrupt reaches a command, it is called one."""

import pytest

from quadrig.io.commands import main


@pytest.mark.parametrize(
    "made_of_it", [None, ImportError("initialization failed"), SystemError("a result, and an error")]
)
def test_what_a_library_makes_of_an_interrupt_is_an_interrupt(monkeypatch, capsys, made_of_it):
    def info() -> None:
        """Be interrupted while a library is loaded."""
        if made_of_it is None:
            raise KeyboardInterrupt
        raise made_of_it from KeyboardInterrupt()

    monkeypatch.setattr(main, "command_function", lambda _: info)
    assert main.run(["info"]) == 130
    assert capsys.readouterr().err == "rig: interrupted; nothing half-written is left behind\n"
