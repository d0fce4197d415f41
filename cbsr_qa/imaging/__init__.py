"""From images to regions: noise floor, percentage masks, blobs, exact clipping."""
