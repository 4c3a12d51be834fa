// The token a person entered, kept for this tab alone, and headers that carry it: for all pages of the service.
const KEY = 'spike4dgs-token';

export const token = () => sessionStorage.getItem(KEY);

export function setToken(text) {
  if (text) sessionStorage.setItem(KEY, text);
  else sessionStorage.removeItem(KEY);
}

export const withToken = (headers = {}) => (token() ? { ...headers, Authorization: `Bearer ${token()}` } : headers);
