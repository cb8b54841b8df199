"""A lane network of the user: an ONNX file, run by OpenCV, and a YAML file that describes it.

`description` reads the YAML, `running` reads the ONNX and runs it, `layouts` reads its outputs,
`finding` fits lines on the road, and `checking` finds the layout of an ONNX file.
"""
