# find_package(plumbline REQUIRED) defines plumbline::plumbline (shared) and plumbline::static. A C compiler is enough.
get_filename_component(_plumbline_prefix "${CMAKE_CURRENT_LIST_DIR}/../../.." ABSOLUTE)

if(NOT TARGET plumbline::plumbline)
  add_library(plumbline::plumbline SHARED IMPORTED)
  set_target_properties(plumbline::plumbline PROPERTIES
    IMPORTED_LOCATION "${_plumbline_prefix}/lib/libplumbline.so"
    IMPORTED_SONAME "libplumbline.so.0"
    INTERFACE_INCLUDE_DIRECTORIES "${_plumbline_prefix}/include")

  add_library(plumbline::static STATIC IMPORTED)
  set_target_properties(plumbline::static PROPERTIES
    IMPORTED_LOCATION "${_plumbline_prefix}/lib/libplumbline.a"
    INTERFACE_INCLUDE_DIRECTORIES "${_plumbline_prefix}/include"
    INTERFACE_LINK_LIBRARIES "pthread;m;dl;rt;util")
endif()

unset(_plumbline_prefix)
