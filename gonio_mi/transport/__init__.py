"""Light transport: from the beam through the specimen to sums, in Dr.Jit kernels."""
