document.querySelectorAll('table.index th button').forEach(function (button) {
  button.addEventListener('click', function () {
    var head = button.parentElement, body = head.closest('table').tBodies[0];
    var column = head.cellIndex, up = head.getAttribute('aria-sort') !== 'ascending';
    var key = function (row) { var cell = row.cells[column], k = cell.dataset.key; return k === undefined ? cell.textContent : k; };
    var rows = Array.prototype.slice.call(body.rows);
    rows.sort(function (a, b) {
      var x = key(a), y = key(b);
      if (x === '' || y === '') return (x === '') - (y === '');
      var order = isNaN(x) || isNaN(y) ? x.localeCompare(y) : x - y;
      return up ? order : -order;
    });
    head.parentElement.querySelectorAll('th').forEach(function (other) { other.removeAttribute('aria-sort'); });
    head.setAttribute('aria-sort', up ? 'ascending' : 'descending');
    rows.forEach(function (row) { body.appendChild(row); });
  });
});
