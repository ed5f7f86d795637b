"""Export of a control law: a sheet of equations and numbers, C, ONNX, FMUs, and a hybrid automaton."""
