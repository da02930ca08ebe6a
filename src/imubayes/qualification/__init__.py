"""Statistics of a qualification report: conformity, uncertainty budget, digits, and the record of the report."""
