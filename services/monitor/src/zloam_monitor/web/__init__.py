"""A page for a person without any tool: robots, their health, path, map and latency.

robot_view  what is shown of one robot, from what any subscriber hears
server      hands it to browsers
page.html, page.css, page.js  the page: no build step, nothing from elsewhere
"""
