"""A lane network of the user's own: an ONNX file, run by OpenCV, and a YAML file that describes it.

`description` reads the YAML, `running` reads the ONNX and takes a picture through the network,
`layouts` reads its outputs, and `finding` makes lines of the road of them. `checking` says which
layout fits a file; `ready` has the YAML of well-known networks.
"""
