// Starts what the page at hand needs.

import { progress } from "./run.js";
import { review } from "./review.js";
import { teach } from "./teach.js";

const { page, run } = document.body.dataset;
const start = { teach, review, run: progress }[page];
if (start && run) start(run);
