"""What turns X-rays into signal, one kind a file: data alone."""
