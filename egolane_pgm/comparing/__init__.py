"""Results side by side: `planning` says which experiments are run on which recording, and runs them
held out; `compared` scores results on the frames that they share; `result` is what comes out."""
