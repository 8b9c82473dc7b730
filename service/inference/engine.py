"""onnxruntime on a CPU: real tensors in, real tensors out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import onnxruntime as ort

from neuralmusic.errors import BundleCorrupt
from service.doa.types import FloatArray


class Engine:
    """One ONNX graph with a fixed thread count; safe to call from several threads.

    Parameters
    ----------
    content : bytes
        The ONNX file.
    name : str
        The file's name, for errors.
    threads : int

    By itself onnxruntime would size its pool by the host's cores, which is ruinous in a limited
    container, and would spin while idle, at the expense of a robot's other programs.
    """

    def __init__(self, content: bytes, name: str, *, threads: int = 1) -> None:
        options = ort.SessionOptions()
        options.intra_op_num_threads = threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 3
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        # The arena would keep the largest batch's memory for good; windows are small and few.
        options.enable_cpu_mem_arena = False
        try:
            self._session = ort.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime's exceptions share no public base
            raise BundleCorrupt(
                f"{name} is not an ONNX graph that onnxruntime loads: {error}"
            ) from error
        self.inputs = [node.name for node in self._session.get_inputs()]
        self.outputs = [node.name for node in self._session.get_outputs()]
        self._shapes = [node.shape for node in self._session.get_inputs()]

    def initial_state(self) -> list[FloatArray]:
        """First state of a stream's graph: zeros for every input after the first, batch of one."""
        return [np.zeros((1, *map(int, shape[1:])), np.float32) for shape in self._shapes[1:]]

    def run(self, inputs: Sequence[FloatArray]) -> list[FloatArray]:
        """The graph's outputs for its inputs, both in the graph's order."""
        outputs: list[FloatArray] = self._session.run(
            self.outputs, dict(zip(self.inputs, inputs, strict=True))
        )
        return outputs
