"""Results of an identification: sentences, the verdict, figures, and its problem file."""
