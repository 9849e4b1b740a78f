"""The steps of a running law, each written once, for one scenario or for eight side by side."""
