"""The part of ONNX's file format that a network may use, by the numbers of onnx.proto.

Left out on purpose, and so refused: functions, training information, sparse and external tensors,
graphs within attributes (control flow), other than tensor types. `skipped` are remarks.
"""

from typing import Final

from vergence.controllers.networks.protobuf import Field, Schema

FLOAT: Final = 1
INT64: Final = 7

_TENSOR = {
    1: Field("dims", "int", repeated=True),
    2: Field("data_type", "int"),
    4: Field("float_data", "float", repeated=True),
    7: Field("int64_data", "int", repeated=True),
    8: Field("name", "text"),
    9: Field("raw_data", "bytes"),
    12: Field("doc_string", "skipped"),
    14: Field("data_location", "int"),
    16: Field("metadata_props", "skipped"),
}
_ATTRIBUTE = {
    1: Field("name", "text"),
    2: Field("f", "float"),
    3: Field("i", "int"),
    4: Field("s", "bytes"),
    5: Field("t", _TENSOR),
    13: Field("doc_string", "skipped"),
    20: Field("type", "int"),
}
_NODE = {
    1: Field("input", "text", repeated=True),
    2: Field("output", "text", repeated=True),
    3: Field("name", "skipped"),
    4: Field("op_type", "text"),
    5: Field("attribute", _ATTRIBUTE, repeated=True),
    6: Field("doc_string", "skipped"),
    7: Field("domain", "text"),
    9: Field("metadata_props", "skipped"),
}
_DIMENSION = {
    1: Field("value", "int"),
    2: Field("param", "text"),
    3: Field("denotation", "skipped"),
}
_TYPE = {
    1: Field(
        "tensor",
        {
            1: Field("elem_type", "int"),
            2: Field("shape", {1: Field("dim", _DIMENSION, repeated=True)}),
        },
    ),
    6: Field("denotation", "skipped"),
}
_VALUE = {
    1: Field("name", "text"),
    2: Field("type", _TYPE),
    3: Field("doc_string", "skipped"),
    4: Field("metadata_props", "skipped"),
}
_GRAPH = {
    1: Field("node", _NODE, repeated=True),
    2: Field("name", "skipped"),
    5: Field("initializer", _TENSOR, repeated=True),
    10: Field("doc_string", "skipped"),
    11: Field("input", _VALUE, repeated=True),
    12: Field("output", _VALUE, repeated=True),
    13: Field("value_info", "skipped"),
    16: Field("metadata_props", "skipped"),
}
MODEL: Final[Schema] = {
    1: Field("ir_version", "int"),
    2: Field("producer_name", "skipped"),
    3: Field("producer_version", "skipped"),
    4: Field("domain", "skipped"),
    5: Field("model_version", "skipped"),
    6: Field("doc_string", "skipped"),
    7: Field("graph", _GRAPH),
    8: Field("opset", {1: Field("domain", "text"), 2: Field("version", "int")}, repeated=True),
    14: Field("metadata_props", "skipped"),
}
"""A whole file (ModelProto)."""
