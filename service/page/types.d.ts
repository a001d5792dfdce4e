// What the page's modules name in their comments: bodies of the interface, made from docs/reference/openapi.json.
import type { components } from "./build/api";

/** Members that the interface leaves open (`additionalProperties`) hold anything. */
type Open<T> = { [K in keyof T]: { [key: string]: unknown } extends T[K] ? any : T[K] };

declare global {
  type Api = components["schemas"];
  type Run = Open<Api["Identification"]>;
  type Cell = Open<Api["CellView"]>;
  type Now = Api["CellState"];
  type Model = { branches: any[]; units?: any; couplings?: any[]; effects?: any[] };
  /** Any element of the page: an id says which, the template what it has. */
  type Control = HTMLElement & {
    value: any; disabled: boolean; open: boolean; checked: boolean; files: FileList; hidden: boolean;
  };
  /** Of vendor/uPlot.iife.min.js. */
  const uPlot: any;
}
