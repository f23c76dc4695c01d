"use strict";

/* Elements of a page, found and made. The first of every page's scripts, so that all are strict. */

const byId = (id) => document.getElementById(id);

function element(tag, properties, ...children) {
  const made = Object.assign(document.createElement(tag), properties);
  made.append(...children);
  return made;
}
