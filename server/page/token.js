// The token that a person entered, kept for this tab only, and the headers that carry it.
const KEY = 'spike4dgs-token';

export const token = () => sessionStorage.getItem(KEY);

export function setToken(text) {
  if (text) sessionStorage.setItem(KEY, text);
  else sessionStorage.removeItem(KEY);
}

export const withToken = (headers = {}) => (token() ? { ...headers, Authorization: `Bearer ${token()}` } : headers);
