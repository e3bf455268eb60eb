"""Files of QPs: recorded, shipped, and in the formats of other projects."""
