"""The inputs and outputs that an ONNX file declares.

OpenCV 5 does not compare a picture with the declared input: a network for grey pictures runs on
coloured ones and gives nonsense. It also has no function that tells the inputs. They are therefore
read here, from the few fields of the file (Protocol Buffers' wire format; field numbers from
onnx.proto) that name them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

#: A size that is not fixed is None. Shape None: none is declared.
Shape = tuple[int | None, ...] | None

# Field numbers of onnx.proto.
_GRAPH = 7  # of ModelProto
_INITIALIZER, _INPUT, _OUTPUT = 5, 11, 12  # of GraphProto
_INITIALIZER_NAME = 8  # of TensorProto
_NAME, _TYPE = 1, 2  # of ValueInfoProto
_TENSOR, _SHAPE, _DIM, _DIM_VALUE = 1, 2, 1, 1  # of TypeProto, its Tensor, TensorShapeProto, ...


@dataclass(frozen=True)
class Ports:
    """The inputs and outputs of a network, in their order: names and shapes."""

    inputs: dict[str, Shape]
    outputs: dict[str, Shape]


def read_ports(content: bytes) -> Ports:
    """The inputs and outputs of an ONNX file. Raises ValueError for what is none."""
    try:
        (graph,) = _messages(memoryview(content), _GRAPH)
        weights = {_name(w, _INITIALIZER_NAME) for w in _messages(graph, _INITIALIZER)}
        inputs = {_name(v, _NAME): _shape(v) for v in _messages(graph, _INPUT)}
        outputs = {_name(v, _NAME): _shape(v) for v in _messages(graph, _OUTPUT)}
    except (IndexError, UnicodeDecodeError) as error:
        raise ValueError(str(error)) from None
    # Older files list the weights among the inputs.
    return Ports({k: v for k, v in inputs.items() if k not in weights}, outputs)


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """The fields of a message: number, and value (an integer, or bytes)."""
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        kind = tag & 7
        if kind == 0:
            value, at = _varint(message, at)
            yield tag >> 3, value
            continue
        length, at = (8 if kind == 1 else 4, at) if kind in (1, 5) else _varint(message, at)
        if kind not in (1, 2, 5) or at + length > len(message):
            raise ValueError("a field is cut off")
        yield tag >> 3, message[at : at + length]
        at += length


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value, shift = 0, 0
    while message[at] & 128:
        value |= (message[at] & 127) << shift
        at, shift = at + 1, shift + 7
    return value | message[at] << shift, at + 1


def _messages(message: memoryview, field: int) -> list[memoryview]:
    return [v for k, v in _fields(message) if k == field and isinstance(v, memoryview)]


def _name(message: memoryview, field: int) -> str:
    return "".join(bytes(name).decode() for name in _messages(message, field))


def _shape(value: memoryview) -> Shape:
    for kind in _messages(value, _TYPE):
        for tensor in _messages(kind, _TENSOR):
            for shape in _messages(tensor, _SHAPE):
                return tuple(_size(dim) for dim in _messages(shape, _DIM))
    return None


def _size(dim: memoryview) -> int | None:
    sizes = [v for k, v in _fields(dim) if k == _DIM_VALUE and isinstance(v, int) and v > 0]
    return sizes[0] if sizes else None
