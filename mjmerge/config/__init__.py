"""Text into frozen values, with every mistake told at once; what is shipped; bounds."""
