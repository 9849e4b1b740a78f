"""What readers look at: figures, tables, verdicts, reports, studies, the audit."""
