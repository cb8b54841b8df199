"""A lane network of the user's own: an ONNX file, run by OpenCV, and a YAML file that describes it.

`description` reads the YAML, `onnx_file` asks the ONNX for its inputs and outputs, `running` takes
a picture through the network, `layouts` turns what comes out into markings of the road from above.
`docs/networks.md` shows the YAML of some well-known networks.
"""
