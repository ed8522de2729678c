"""How tests spoil a valid table."""


def set_cell(row, column, value):
    """A change of a table: one cell gets another value, of any type."""

    def change(table):
        table[column] = table[column].astype(object)
        table.loc[row, column] = value
        return table

    return change
