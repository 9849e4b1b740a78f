"""Tables, as the command line and reports print them."""
