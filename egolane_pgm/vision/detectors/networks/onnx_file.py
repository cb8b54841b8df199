"""What an ONNX file declares, read by the package onnx.

OpenCV 5 does not compare a picture with the declared input: a network for grey pictures runs on
coloured ones and gives nonsense. It also has no function that lists the inputs.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from egolane_pgm.tools.extras import needed
from egolane_pgm.types import InputError

if TYPE_CHECKING:
    from onnx import ValueInfoProto

#: A size that is not fixed is None. Shape None: none is declared.
Shape = tuple[int | None, ...] | None


@dataclass(frozen=True)
class Declared:
    """A network as its file has it.

    - inputs, outputs: their names and shapes, in their order
    - types: the types of the inputs
    - content: the file, with the weights that it keeps in others
    """

    inputs: dict[str, Shape]
    outputs: dict[str, Shape]
    types: dict[str, np.dtype[Any]]
    content: bytes


def read_onnx(path: Path, where: str) -> Declared:
    """Read a network with its weights. Raises InputError, starting with `where`, for a file that
    cannot be read or is no ONNX, and if weights are missing."""
    with needed(f"{where}: {path}", "vision"):
        import onnx
        from google.protobuf.message import DecodeError
    try:
        # Without a format onnx would take a file that ends in .json or .txt for text.
        model = onnx.load(str(path), format="protobuf")
    except OSError as error:
        raise InputError(f"{where}: {path}: {error.strerror or error}") from None
    except (DecodeError, ValueError, onnx.checker.ValidationError) as error:
        said = " ".join(str(error).split())[:240]
        raise InputError(f"{where}: {path}: is no ONNX file that can be read: {said}") from None
    if not model.graph.output:
        raise InputError(f"{where}: {path}: is no ONNX file")
    # Older files list the weights among the inputs.
    weights = {tensor.name for tensor in model.graph.initializer}
    inputs = [port for port in model.graph.input if port.name not in weights]
    kinds = {port.name: port.type.tensor_type.elem_type for port in inputs}
    return Declared(
        {port.name: _shape(port) for port in inputs},
        {port.name: _shape(port) for port in model.graph.output},
        {name: onnx.helper.tensor_dtype_to_np_dtype(kind) for name, kind in kinds.items()},
        model.SerializeToString(),
    )


def _shape(port: ValueInfoProto) -> Shape:
    tensor = port.type.tensor_type
    if not tensor.HasField("shape"):
        return None
    return tuple(size.dim_value if size.dim_value > 0 else None for size in tensor.shape.dim)
