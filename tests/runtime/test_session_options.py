"""Networks share the processor with the encoder and with other programs."""

from omnisyn_cli.runtime.models import find_model
from omnisyn_cli.runtime.session import open_session


def test_threads_that_wait_sleep() -> None:
    session = open_session(find_model("completion-balanced"), device="cpu", threads=2)
    options = session.get_session_options()
    assert options.get_session_config_entry("session.intra_op.allow_spinning") == "0"
    assert options.intra_op_num_threads == 2
