"""Files of other programs and instruments, read and written without a renderer."""
