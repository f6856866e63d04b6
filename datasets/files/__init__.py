"""Files in general: written whole or not at all, read with errors of one line."""
