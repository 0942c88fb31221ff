"""Skills for cloth: grasp points of a sheet, and fold, flatten or slide the sheet with them."""
