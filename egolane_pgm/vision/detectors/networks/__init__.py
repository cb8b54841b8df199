"""A lane network of the user's own: an ONNX file, run by OpenCV, and a YAML file that describes it.

`description` reads the YAML, `onnx_file` asks the ONNX for its inputs and outputs, `running` takes
a picture through the network, `layouts` chooses what reads its outputs (`masks`, `anchors`,
`polylines`, `segments`, `curves`, `road_lines`), `looking` does so over a drive, and `finding`
makes lines of the road of them. `checking` says which layout fits a file; `ready` has the YAML of
well-known networks.
"""
