import pytest
import torch


@pytest.fixture(autouse=True)
def _one_thread():
    """Small tensors: a second thread costs more than it brings, the more so on a busy machine."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)
